/* What stands over the scene's frame follows its drawings: its camera, and what to do after each of them. */

import {sceneWindow} from './core.mjs';

export const SVG = 'http://www.w3.org/2000/svg';

/* The product of two 4 x 4 matrices that stand column by column, as three.js has them. */
export function times(a, b) {
  const made = new Float64Array(16);
  for (let c = 0; c < 4; c++) {
    for (let r = 0; r < 4; r++) {
      for (let k = 0; k < 4; k++) made[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return made;
}

/* x, y in pixels and the distance along the view; null behind the camera. */
export function project(m, x, y, z, W, H) {
  const w = m[3] * x + m[7] * y + m[11] * z + m[15];
  if (w < 0.02) return null;
  return [
    (((m[0] * x + m[4] * y + m[8] * z + m[12]) / w + 1) / 2) * W,
    ((1 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w) / 2) * H,
    w,
  ];
}

/* From three.js's coordinates to those of the picture; null while there is no scene. */
export function viewMatrix() {
  const camera = sceneWindow()?.__viserMutable?.camera;
  return camera ? times(camera.projectionMatrix.elements, camera.matrixWorldInverse.elements) : null;
}

/* The same from the server's coordinates: viser turns its scene so that up is y. */
export function sceneMatrix() {
  const view = viewMatrix(), root = sceneWindow()?.__viserMutable?.nodeRefFromName?.[''];
  return view && root?.matrixWorld ? times(view, root.matrixWorld.elements) : null;
}

const leaders = [], followers = [];
let hooked = null;
const drawn = () => followers.forEach(follower => follower());
export const beforeDrawing = leader => leaders.push(leader);
export const afterDrawing = follower => followers.push(follower);

/* Before and after each drawing of the scene; until there is one, and where it cannot be followed, after each of the page. */
function follow() {
  const scene = sceneWindow()?.__viserMutable?.scene;
  if (scene && scene !== hooked) {
    hooked = scene;
    const before = scene.onBeforeRender, after = scene.onAfterRender;
    scene.onBeforeRender = function (...given) {
      before?.apply(this, given);
      leaders.forEach(leader => leader());
    };
    scene.onAfterRender = function (...given) {
      after?.apply(this, given);
      drawn();
    };
  }
  if (!scene) drawn();
  requestAnimationFrame(follow);
}
follow();
