/* Lengths over the scene: a scale bar at the depth of what is looked at, and the line between two measured points. */

import {byId, calls, el, sceneHost, sceneWindow} from './core.mjs';
import {SVG, afterDrawing, project, sceneMatrix} from './scene.mjs';

const LONGEST = 100;

/* The longest of 1, 2, 5 times a power of ten that is not longer than `most`. */
export function roundLength(most) {
  const ten = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].find(n => n * ten <= most * (1 + 1e-9)) * ten;
}

export const lengthText = m => (m >= 0.1 ? `${+m.toPrecision(3)} m` : m >= 0.01 ? `${+(100 * m).toPrecision(3)} cm` : `${+(1000 * m).toPrecision(3)} mm`);

let looked = null, shown = '';

function scale() {
  const host = sceneHost(), W = host.clientWidth, H = host.clientHeight, view = sceneMatrix();
  const at = looked && view && W ? project(view, ...looked.center, W, H) : null, control = sceneWindow()?.__viserMutable?.cameraControl;
  // Nearer there would be only points, each for itself.
  if (control && looked) control.minDistance = looked.nearest;
  let said = '';
  if (at) {
    // The picture's height in metres at that depth, by the second row of the projection.
    const perMetre = (Math.hypot(view[1], view[5], view[9]) / at[2]) * (H / 2);
    const length = roundLength(LONGEST / perMetre);
    said = `${(length * perMetre).toFixed(1)}|${lengthText(length)} at ${looked.name}`;
  }
  if (said === shown) return;
  shown = said;
  const [width, text] = said.split('|');
  byId('scale').hidden = !said;
  if (!said) return;
  if (!byId('scale').childElementCount) byId('scale').append(el('span', 'text'), el('span', 'rule'));
  const [words, rule] = byId('scale').children;
  words.textContent = text;
  rule.style.width = `${width}px`;
}
calls.scale = data => {
  looked = data;
  scale();
};
afterDrawing(scale);

/* ---- a measured line */

let points = [], layer = null;

function line() {
  const view = sceneMatrix(), host = sceneHost();
  if (!layer?.isConnected) {
    if (!points.length) return;
    layer = document.createElementNS(SVG, 'svg');
    layer.setAttribute('class', 'measure');
    layer.setAttribute('aria-hidden', 'true');
    host.prepend(layer);
  }
  const ends = view ? points.map(p => project(view, ...p, host.clientWidth, host.clientHeight)) : [];
  const made = [];
  const add = (name, values) => {
    const one = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(values)) one.setAttribute(key, value.toFixed(1));
    made.push(one);
  };
  if (ends.length === 2 && ends[0] && ends[1]) add('line', {x1: ends[0][0], y1: ends[0][1], x2: ends[1][0], y2: ends[1][1]});
  for (const end of ends) if (end) add('circle', {cx: end[0], cy: end[1], r: 4.5});
  layer.replaceChildren(...made);
}
calls.measure = data => {
  points = data?.points ?? [];
  byId('stage').classList.toggle('measuring', Boolean(data?.on));
  line();
};
afterDrawing(line);
