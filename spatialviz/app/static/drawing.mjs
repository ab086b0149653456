/* How viser's lines and points are drawn: lines of boxes with a dark halo, faint where something hides them; points of at
most a few pixels. */

import {sceneWindow} from './core.mjs';
import {light} from './lit.mjs';
import {beforeDrawing} from './scene.mjs';

const HALO = 0x0b0d10, HALO_WIDTH = 1, HIDDEN = 0.45, THICK = 2.5;
const LARGEST_POINT = 6, USUAL_HEIGHT = 800;
const GREATER_DEPTH = 6; // As three.js counts its tests of depth
const SIZE = 'gl_PointSize = (scale / -world_pos.z);';

/* The same lines once more, with another material. */
function pass(line, order, given) {
  const material = new line.material.constructor({...given, depthWrite: false, toneMapped: false});
  const made = new line.constructor(line.geometry, material);
  made.renderOrder = order;
  made.frustumCulled = false;
  made.raycast = () => {};
  return made;
}

function passes(line) {
  const old = line.parent.userData.passes;
  if (old?.line === line) return old;
  old?.all.forEach(one => one.removeFromParent());
  const halo = pass(line, 1, {color: HALO}), hidden = pass(line, 2, {transparent: true, opacity: HIDDEN, depthFunc: GREATER_DEPTH});
  line.renderOrder = 3;
  // The palette's own colours, as in the picture and in the legend.
  Object.assign(line.material, {toneMapped: false, needsUpdate: true});
  line.parent.add(halo, hidden);
  return (line.parent.userData.passes = {line, halo, hidden, all: [halo, hidden]});
}

function dress(line) {
  const {halo, hidden, all} = passes(line), {material} = line;
  for (const one of all) {
    one.geometry = line.geometry;
    one.material.resolution.copy(material.resolution);
    one.updateMatrixWorld(true);
  }
  halo.visible = material.linewidth >= THICK;
  halo.material.linewidth = material.linewidth + 2 * HALO_WIDTH;
  hidden.material.linewidth = material.linewidth;
  hidden.material.color.copy(material.color);
  if (hidden.material.vertexColors !== material.vertexColors) {
    hidden.material.vertexColors = material.vertexColors;
    hidden.material.needsUpdate = true;
  }
}

/* A point is told its size by the vertex shader: nothing else of viser bounds it. */
const largest = {value: LARGEST_POINT};
function limit(material) {
  if (material.uniforms.largest || !material.vertexShader.includes(SIZE)) return;
  material.uniforms.largest = largest;
  material.vertexShader = `uniform float largest;\n${material.vertexShader.replace(SIZE, 'gl_PointSize = min(scale / -world_pos.z, largest);')}`;
  material.needsUpdate = true;
}

beforeDrawing(() => {
  const {__viserMutable: {nodeRefFromName: nodes}, devicePixelRatio, innerHeight} = sceneWindow();
  // A taller view spreads the same points farther.
  largest.value = LARGEST_POINT * devicePixelRatio * Math.max(1, innerHeight / USUAL_HEIGHT);
  for (const [name, node] of Object.entries(nodes)) {
    if (!node) continue;
    if (name.startsWith('/boxes/') || name.startsWith('/edit/')) {
      const line = node.getObjectByProperty('isLineSegments2', true);
      if (line) dress(line);
    } else if (name.startsWith('/cloud/')) {
      const points = node.getObjectByProperty('isPoints', true);
      if (!points) continue;
      limit(points.material);
      light(name, node, points);
    }
  }
});
