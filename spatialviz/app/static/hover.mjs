/* One object under the pointer or the focus: marked in its rows, in the picture and in the scene, without the server.

Rows name their objects by `data-hover="hover:3"`, those of a pair by "hover:3,7"; between two a line is drawn. */

import {byId, calls, el, sceneHost, sceneWindow} from './core.mjs';
import {SVG, afterDrawing, project, sceneMatrix} from './scene.mjs';
import {BOX_EDGES, CORNERS, overlap, standing} from './tags.mjs';

/* By number: boxes of the scene {center, R, half, volume} or null; rectangles in the picture. `map`: pixels of a
small picture of the frame, in which each pixel is 1 + the number of the smallest object there. */
let objects = {boxes: [], rects: []}, names = [], map = null, marked = [];

calls.names = list => { names = list; };
calls.objects = data => {
  objects = data ?? {boxes: [], rects: []};
  map = null;
  mark([]);
  if (!data) return;
  const image = new Image();
  image.onload = () => {
    const canvas = Object.assign(el('canvas'), {width: image.width, height: image.height});
    const pen = canvas.getContext('2d', {willReadFrequently: true});
    pen.drawImage(image, 0, 0);
    if (objects === data) map = pen.getImageData(0, 0, image.width, image.height);
  };
  image.src = data.map;
};

/* ---- what is under the pointer */

export function inPicture(x, y) {
  if (!map) return [];
  const column = Math.min(map.width - 1, Math.floor(x * map.width)), row = Math.min(map.height - 1, Math.floor(y * map.height));
  const at = 4 * (row * map.width + column), number = map.data[at] + 256 * map.data[at + 1] - 1;
  return number < 0 ? [] : [number];
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/* Whether a ray meets a box: the slabs along its three axes, the columns of R. */
export function meets({center, R, half}, origin, direction) {
  let enter = 0, leave = Infinity;
  const offset = center.map((c, k) => c - origin[k]);
  for (let k = 0; k < 3; k++) {
    const axis = [R[k], R[3 + k], R[6 + k]], along = dot(axis, direction) || 1e-12, middle = dot(axis, offset);
    const [a, b] = [(middle - half[k]) / along, (middle + half[k]) / along];
    enter = Math.max(enter, Math.min(a, b));
    leave = Math.min(leave, Math.max(a, b));
  }
  return enter <= leave;
}

/* The smallest box under a point of the scene's frame, as a click selects: a mug rather than the table around it. */
export function inScene(x, y) {
  const {camera, nodeRefFromName: nodes} = sceneWindow()?.__viserMutable ?? {}, root = nodes?.[''];
  if (!camera || !root) return [];
  const toScene = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).multiply(root.matrixWorld).invert();
  const from = camera.position.clone().setFromMatrixPosition(camera.matrixWorld).applyMatrix4(root.matrixWorld.clone().invert());
  const {innerWidth: W, innerHeight: H} = sceneWindow();
  const to = camera.position.clone().set((2 * x) / W - 1, 1 - (2 * y) / H, 0.5).applyMatrix4(toScene);
  const origin = from.toArray(), direction = to.toArray().map((v, k) => v - origin[k]);
  const hit = objects.boxes.map((box, i) => [box, i]).filter(([box]) => box && meets(box, origin, direction));
  return hit.sort(([a], [b]) => a.volume - b.volume).slice(0, 1).map(([, i]) => i);
}

/* ---- marks */

const rows = new CSSStyleSheet();
document.adoptedStyleSheets.push(rows);
let layer = null, name = null;

function mark(numbers) {
  const now = numbers.filter(i => i < objects.boxes.length);
  if (now.join() === marked.join()) return;
  marked = now;
  rows.replaceSync(now.length ? `[data-hover="hover:${now.join()}"]{background:var(--hover);outline:2px solid var(--accent);outline-offset:-2px}` : '');
  const picture = byId('marked');
  picture?.replaceChildren(...now.map(i => objects.rects[i]).filter(Boolean).map(([x0, y0, x1, y1]) => {
    const rect = document.createElementNS(SVG, 'rect');
    for (const [key, value] of Object.entries({x: x0, y: y0, width: x1 - x0, height: y1 - y0})) rect.setAttribute(key, value);
    return rect;
  }));
  stand();
}

function stand() {
  if (!layer?.isConnected) {
    if (!marked.length) return;
    layer = document.createElementNS(SVG, 'svg');
    layer.setAttribute('class', 'hovered');
    layer.setAttribute('aria-hidden', 'true');
    name = el('div', 'tag weak hovering');
    name.setAttribute('aria-hidden', 'true');
    sceneHost().append(layer, name);
  }
  const view = marked.length && sceneMatrix(), {clientWidth: W, clientHeight: H} = sceneHost(), drawn = [];
  const boxes = view ? marked.map(i => objects.boxes[i]).filter(Boolean) : [];
  let top = null, low = null;
  for (const {center, R, half} of boxes) {
    const ends = CORNERS.map(signs => project(view, ...center.map((c, k) => c + dot(R.slice(3 * k, 3 * k + 3), signs.map((s, j) => s * half[j]))), W, H));
    for (const [i, j] of BOX_EDGES) if (ends[i] && ends[j]) drawn.push(ends[i].slice(0, 2), ends[j].slice(0, 2));
    for (const end of ends.filter(Boolean)) {
      if (!top || end[1] < top[1]) top = end;
      if (!low || end[1] > low[1]) low = end;
    }
  }
  const middles = boxes.length === 2 ? boxes.map(box => project(view, ...box.center, W, H)) : [];
  if (middles[0] && middles[1]) drawn.push(...middles.map(middle => middle.slice(0, 2)));
  const path = drawn.map(([x, y], k) => `${k % 2 ? 'L' : 'M'}${x.toFixed(1)} ${y.toFixed(1)}`).join('');
  layer.innerHTML = path && `<path d="${path}"/><path d="${path}"/>`;
  name.style.visibility = top && boxes.length === 1 ? 'visible' : 'hidden';
  if (!top) return;
  name.textContent = names[marked[0]];
  const {offsetWidth: w, offsetHeight: h} = name, others = standing();
  const [x, y] = [[top[0], top[1] - h - 4], [low[0], low[1] + 4], [top[0], top[1] + 4]]
    .map(([x, y]) => [Math.max(2, Math.min(W - w - 2, x - w / 2)), Math.max(2, Math.min(H - h - 2, y))])
    .find(([x, y]) => others.every(other => !overlap([x, y, x + w, y + h], other))) ?? [2, 2];
  name.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
}
afterDrawing(stand);

export const markedObjects = () => marked;

/* ---- pointer and focus */

const named = e => (e instanceof Element && e.closest('[data-hover]')?.dataset.hover.match(/^hover:([\d,]+)$/)?.[1].split(',').map(Number)) || [];
const pointed = e => {
  const pic = e.target instanceof Element && e.target.closest('.pic'), box = pic?.getBoundingClientRect?.();
  mark(box ? inPicture((e.clientX - box.left) / box.width, (e.clientY - box.top) / box.height) : named(e.target));
};
document.addEventListener('pointermove', pointed);
document.addEventListener('pointerleave', () => mark([]));
document.addEventListener('focusin', e => mark(named(e.target)));

byId('view').addEventListener('load', () => {
  const w = sceneWindow();
  // While the view is turned nothing is pointed at.
  w.addEventListener('pointermove', e => mark(e.buttons ? [] : inScene(e.clientX, e.clientY)));
  w.document.documentElement.addEventListener('pointerleave', () => mark([]));
});
