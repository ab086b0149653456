/* Points of an answer in their own colours, all others dimmed: by the browser, which finds the pixel of each point by the
frame's camera. The colours that are sent stay as they are. */

import {calls, sceneWindow} from './core.mjs';
import {isThere} from './frame.mjs';

/* Of viser's vertex shader, and what it becomes. */
const COLOR = 'vColor = color;';
const DIMMED = 'vColor = isLit > 0.5 ? color : (dimming * vec4(color, 1.0)).rgb;';
const DECLARED = 'attribute float isLit;\nuniform mat4 dimming;\n';
const PLAIN = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/* `mask`: lit pixels, column by column; `toPixel`: from a point to its pixel, 3 x 3; null where nothing is dimmed. */
let lit = null;
const dimming = {value: PLAIN};

/* COCO's compressed run lengths (`run_lengths` of the core), as one byte a pixel. */
function decoded(counts, [height, width]) {
  const mask = new Uint8Array(height * width), runs = [];
  for (let at = 0, end = 0; at < counts.length;) {
    let value = 0, shift = 0, code;
    do {
      code = counts.charCodeAt(at++) - 48;
      value |= (code & 31) << shift;
      shift += 5;
    } while (code & 32);
    if (code & 16) value |= -1 << shift;
    if (runs.length > 2) value += runs.at(-2);
    runs.push(value);
    if (runs.length % 2 === 0) mask.fill(1, end, end + value);
    end += value;
  }
  return mask;
}

calls.lit = data => {
  lit = data && {...data, mask: decoded(data.counts, data.size)};
  // Column by column, as a shader has it.
  dimming.value = data ? [0, 1, 2, 3].flatMap(column => [...[0, 1, 2].map(row => data.dim[4 * row + column]), column === 3 ? 1 : 0]) : PLAIN;
  sceneWindow()?.__viserMutable?.requestRender?.();
};

/* Sets `found`: whether each point at an offset from a node's place is lit. */
function mark(found, {mask, size: [height, width], toPixel: m}, position, {x, y, z}) {
  for (let k = 0; k < position.count; k++) {
    const px = position.getX(k) + x, py = position.getY(k) + y, pz = position.getZ(k) + z;
    const far = m[6] * px + m[7] * py + m[8] * pz;
    const column = Math.round((m[0] * px + m[1] * py + m[2] * pz) / far), row = Math.round((m[3] * px + m[4] * py + m[5] * pz) / far);
    if (column >= 0 && column < width && row >= 0 && row < height) found[k] = mask[column * height + row];
  }
}

/* Before a drawing: the points of a node of the scene as the answer wants them. */
export function light(name, node, points) {
  const {material, geometry} = points, {position, color, isLit} = geometry.attributes;
  if (!material.uniforms.dimming && material.vertexShader.includes(COLOR)) {
    material.uniforms.dimming = dimming;
    material.vertexShader = DECLARED + material.vertexShader.replace(COLOR, DIMMED);
    material.needsUpdate = true;
  }
  if (!position || (isLit?.count === position.count && isLit.of === position.array && (isLit.by === lit || !lit))) return;
  // An array of the scene's own window; points of another frame wait for theirs.
  const found = new color.array.constructor(position.count), now = lit && isThere(name) ? lit : null;
  if (now) mark(found, now, position, node.position);
  geometry.setAttribute('isLit', Object.assign(new color.constructor(found, 1), {of: position.array, by: now}));
}
