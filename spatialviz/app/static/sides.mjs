/* Three views of a labelled object, along the axes of its box: its points come once, its box follows the hand here,
and goes to the server as one edit when it is let go (pipeline/corrections/side_views.py does the same to the box). */

import {byId, calls, el, locals, send} from './core.mjs';

/* Axes a, b, c of each view, to the right and up, and the one that it is looked along. */
const VIEWS = [
  {name: 'top', title: 'Top', h: 0, v: 1, along: 2},
  {name: 'front', title: 'Front', h: 0, v: 2, along: 1},
  {name: 'side', title: 'Side', h: 1, v: 2, along: 0},
];
const LEAST = 0.01, NEAR = 8, GRIP = 5, TURN = 22, STEP = 0.01, ANGLE = Math.PI / 90, REST_MS = 700;
const KEYS = {ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1]};
const CURSORS = {face: ['ew-resize', 'ns-resize'], corner: 'move', move: 'grab', turn: 'crosshair'};

/* box: centre and size along a, b, c, and how far it is turned in the view that turns it. */
const S = {data: null, box: null, moves: [], hand: null, active: 0, timer: 0, colors: {}};
let bench = null, views = [];

const unpacked = text => {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return new Int16Array(bytes.buffer, 0, bytes.length >> 1);
};
const fresh = () => ({center: [0, 0, 0], size: [...S.data.size], turned: 0, about: -1});

/* What moves do to the box: each face goes outwards, and the opposite one stays. */
const after = (box, moves) => {
  const made = {...box, center: [...box.center], size: [...box.size]};
  for (const [what, axis, ...rest] of moves) {
    if (what === 'move') made.center[axis] += rest[0];
    else if (what === 'turn') { made.turned += rest[0]; made.about = axis; }
    else {
      const [side, by] = rest, grown = Math.max(made.size[axis] + by, LEAST) - made.size[axis];
      made.size[axis] += grown;
      made.center[axis] += side * grown / 2;
    }
  }
  return made;
};

// ---- drawing

const half = view => [view.h, view.v].map(k => S.data.size[k] / 2 + 0.1 + 0.3 * Math.max(...S.data.size));
const placed = view => {
  const {width, height} = view.canvas, [x, y] = half(view);
  return {scale: view.zoom * Math.min(width / (2 * x), height / (2 * y)), x: width / 2, y: height / 2};
};
const corners = (view, box) => {
  const x = box.size[view.h] / 2, y = box.size[view.v] / 2, turn = box.about === view.along ? box.turned : 0;
  // About b the views' axes a, c turn the other way than about c the axes a, b.
  const angle = view.along === 1 ? -turn : turn, cos = Math.cos(angle), sin = Math.sin(angle);
  const reach = box.about >= 0 && box.about !== view.along;
  return [[-x, -y], [x, -y], [x, y], [-x, y]].map(([u, v]) => reach ? [u, v] : [u * cos - v * sin, u * sin + v * cos])
    .map(([u, v]) => [u + box.center[view.h], v + box.center[view.v]]);
};
const onCanvas = (view, p) => { const at = placed(view); return [at.x + p[0] * at.scale, at.y - p[1] * at.scale]; };

const dots = (view, points, color, size) => {
  const at = placed(view), {draw} = view;
  draw.fillStyle = color;
  for (let i = 0; i + 2 < points.length; i += 3) {
    draw.fillRect(at.x + points[i + view.h] * at.scale / 1000, at.y - points[i + view.v] * at.scale / 1000, size, size);
  }
};

const grid = (view, ratio) => {
  const {draw, canvas} = view, at = placed(view);
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5].find(s => s * at.scale > 44 * ratio) ?? 10;
  draw.strokeStyle = S.colors.line;
  draw.lineWidth = ratio;
  draw.beginPath();
  for (let x = at.x % (step * at.scale); x < canvas.width; x += step * at.scale) { draw.moveTo(x, 0); draw.lineTo(x, canvas.height); }
  for (let y = at.y % (step * at.scale); y < canvas.height; y += step * at.scale) { draw.moveTo(0, y); draw.lineTo(canvas.width, y); }
  draw.stroke();
  return step;
};

const paint = view => {
  const {canvas, draw} = view, ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
  draw.clearRect(0, 0, width, height);
  if (!S.data || !width) return;
  const step = grid(view, ratio), box = S.box, held = S.hand?.view === view ? S.hand.grip : view.over;
  dots(view, S.data.around, S.colors.around, 1.2 * ratio);
  dots(view, S.data.points, S.colors.own, 1.7 * ratio);
  const ring = corners(view, box).map(p => onCanvas(view, p));
  const color = S.moves.length || S.hand ? S.colors.edited : S.colors.truth;
  draw.strokeStyle = draw.fillStyle = color;
  draw.lineJoin = 'round';
  for (const [width, stroke] of [[4 * ratio, S.colors.ground], [2 * ratio, color]]) {
    draw.lineWidth = width;
    draw.strokeStyle = stroke;
    draw.beginPath();
    ring.forEach(([x, y], i) => (i ? draw.lineTo(x, y) : draw.moveTo(x, y)));
    draw.closePath();
    draw.stroke();
  }
  draw.strokeStyle = color;
  if (held?.faces) {
    draw.lineWidth = 4 * ratio;
    for (const {from, to} of held.faces) { draw.beginPath(); draw.moveTo(...ring[from]); draw.lineTo(...ring[to]); draw.stroke(); }
  }
  const grip = GRIP * ratio;
  for (const [x, y] of ring) draw.fillRect(x - grip / 2, y - grip / 2, grip, grip);
  const [x, y] = turner(view, ratio);
  draw.lineWidth = 1.5 * ratio;
  draw.beginPath();
  draw.arc(x, y, grip, 0, 7);
  draw.stroke();
  view.told.textContent = `${box.size[view.h].toFixed(2)} × ${box.size[view.v].toFixed(2)} m`;
  view.scaled.textContent = `grid ${step >= 1 ? `${step} m` : `${Math.round(step * 100)} cm`}`;
};

const turner = (view, ratio) => {
  const ring = corners(view, S.box).map(p => onCanvas(view, p));
  const [a, b, c] = [ring[0], ring[2], ring[3]], middle = [(b[0] + c[0]) / 2, (b[1] + c[1]) / 2];
  const up = [c[0] - a[0], c[1] - a[1]], long = Math.hypot(...up) || 1;
  return [middle[0] + up[0] / long * TURN * ratio, middle[1] + up[1] / long * TURN * ratio];
};

let waiting = 0;
const redraw = () => { waiting ||= requestAnimationFrame(() => { waiting = 0; for (const view of views) paint(view); }); };

const recolor = () => {
  const style = getComputedStyle(document.body), of = name => style.getPropertyValue(name).trim();
  const ground = of('--field');
  S.colors = {line: of('--line'), around: of('--edge'), own: of('--text'), truth: of('--truth'), edited: of('--edited'), ground};
  redraw();
};

// ---- what the hand takes hold of

/* The faces of a view by the corners between which they stand. */
const FACES = [[0, -1, 3, 0], [0, 1, 1, 2], [1, -1, 0, 1], [1, 1, 2, 3]];
const gripAt = (view, [x, y], ratio) => {
  const ring = corners(view, S.box).map(p => onCanvas(view, p)), [tx, ty] = turner(view, ratio);
  if (Math.hypot(x - tx, y - ty) < 1.6 * NEAR * ratio) return {what: 'turn'};
  const near = FACES.map(([axis, side, from, to]) => {
    const [p, q] = [ring[from], ring[to]], d = [q[0] - p[0], q[1] - p[1]], long = d[0] * d[0] + d[1] * d[1] || 1;
    const t = Math.min(1, Math.max(0, ((x - p[0]) * d[0] + (y - p[1]) * d[1]) / long));
    return {axis, side, from, to, far: Math.hypot(x - p[0] - t * d[0], y - p[1] - t * d[1])};
  }).filter(f => f.far < NEAR * ratio).sort((f, g) => f.far - g.far);
  const second = near.find(f => f.axis !== near[0].axis);
  if (near.length) return {what: second ? 'corner' : 'face', faces: second ? [near[0], second] : [near[0]]};
  const xs = ring.map(p => p[0]), ys = ring.map(p => p[1]);
  const inside = x > Math.min(...xs) && x < Math.max(...xs) && y > Math.min(...ys) && y < Math.max(...ys);
  return inside ? {what: 'move'} : null;
};

const pixel = (view, event) => {
  const b = view.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  return [(event.clientX - b.left) * ratio, (event.clientY - b.top) * ratio];
};
const metres = (view, p) => { const at = placed(view); return [(p[0] - at.x) / at.scale, (at.y - p[1]) / at.scale]; };

/* With Ctrl a face goes to the nearest point of the object. */
const snapped = (axis, to) => {
  let best = to, far = 0.1;
  for (let i = axis; i < S.data.points.length; i += 3) {
    const off = Math.abs(S.data.points[i] / 1000 - to);
    if (off < far) [best, far] = [S.data.points[i] / 1000, off];
  }
  return best;
};

const movesOf = (hand, event) => {
  const {view, grip, from} = hand, now = metres(view, pixel(view, event)), axes = [view.h, view.v];
  if (grip.what === 'move') return axes.map((axis, k) => ['move', axis, now[k] - from[k]]).filter(m => m[2]);
  if (grip.what === 'turn') {
    const angle = p => Math.atan2(p[1] - hand.box.center[view.v], p[0] - hand.box.center[view.h]);
    let by = angle(now) - angle(from);
    by = Math.atan2(Math.sin(by), Math.cos(by));
    if (event.shiftKey) by = Math.round(by / (Math.PI / 12)) * Math.PI / 12;
    return by ? [['turn', view.along, view.along === 1 ? -by : by]] : [];
  }
  return grip.faces.map(({axis: k, side}) => {
    const axis = axes[k], end = hand.box.center[axis] + side * hand.box.size[axis] / 2;
    let to = end + now[k] - from[k];
    if (event.ctrlKey || event.metaKey) to = snapped(axis, to);
    return ['face', axis, side, side * (to - end)];
  }).filter(m => m[3]);
};

const shown = moves => moves.map(m => m.map(v => (typeof v === 'number' ? +v.toFixed(5) : v)));
const commit = () => {
  clearTimeout(S.timer);
  S.timer = 0;
  if (S.moves.length) send('side-drag', S.data.key, shown(S.moves));
};

const down = (view, event) => {
  if (!S.data || event.button) return;
  const at = pixel(view, event), grip = gripAt(view, at, window.devicePixelRatio || 1);
  commit();
  activate(views.indexOf(view));
  if (!grip || S.moves.length) return;
  view.canvas.setPointerCapture(event.pointerId);
  S.hand = {view, grip, from: metres(view, at), box: S.box};
  redraw();
};
const move = (view, event) => {
  if (!S.data) return;
  if (S.hand) S.box = after(S.hand.box, movesOf(S.hand, event));
  else {
    view.over = gripAt(view, pixel(view, event), window.devicePixelRatio || 1);
    const cursor = view.over && CURSORS[view.over.what];
    view.canvas.style.cursor = Array.isArray(cursor) ? cursor[view.over.faces[0].axis] : cursor || 'default';
  }
  redraw();
};
const up = (view, event) => {
  if (!S.hand) return;
  S.moves = movesOf(S.hand, event);
  S.hand = null;
  commit();
  redraw();
};
const dropped = () => { S.hand = null; S.moves = []; if (S.data) S.box = fresh(); redraw(); };

// ---- keys: while the views have the focus

const activate = k => {
  S.active = k;
  views.forEach((view, i) => view.figure.classList.toggle('on', i === k));
};
const pressed = event => {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const view = views[S.active], arrow = KEYS[event.key];
  const taken = () => { event.preventDefault(); event.stopPropagation(); };
  if (event.key === 'Tab') { taken(); commit(); send(`next-object:${event.shiftKey ? -1 : 1}`); }
  else if (event.key === 'Escape') {
    taken();
    if (S.hand || S.timer) { clearTimeout(S.timer); S.timer = 0; dropped(); }
    else byId('decide').querySelector('button:enabled')?.focus() ?? bench.blur();
  } else if (!S.data) return;
  else if (event.key === 'v' || event.key === 'V') { taken(); activate((S.active + 1) % views.length); }
  else if (arrow) {
    taken();
    const [k, sign] = arrow, axis = [view.h, view.v][k];
    step(event.shiftKey ? ['face', axis, 1, sign * STEP] : ['move', axis, sign * STEP]);
  } else if (event.key === ',' || event.key === '.') {
    taken();
    step(['turn', view.along, (event.key === ',' ? 1 : -1) * (view.along === 1 ? -ANGLE : ANGLE)]);
  }
};
/* Steps by keys are one edit once they rest. */
const step = one => {
  const last = S.moves.at(-1), n = one.length - 1;
  if (last && last.slice(0, n).join() === one.slice(0, n).join()) last[n] += one[n];
  else if (S.moves.length < 12) S.moves.push(one);
  S.box = after(fresh(), S.moves);
  clearTimeout(S.timer);
  S.timer = setTimeout(commit, REST_MS);
  redraw();
};

// ---- what stands there

const build = () => {
  bench = byId('sides');
  bench.tabIndex = 0;
  bench.setAttribute('role', 'application');
  bench.setAttribute('aria-label', 'Side views of the object: arrows move its box, Shift and arrows an edge, comma and ' +
    'full stop turn it, V takes the next view, Tab the next object, Escape leaves');
  bench.addEventListener('keydown', pressed);
  views = VIEWS.map(view => {
    const figure = el('figure', 'side-view'), canvas = el('canvas'), caption = el('figcaption');
    const told = el('span'), scaled = el('span', 'dim');
    figure.dataset.view = view.name;
    caption.append(el('b', '', view.title), told, scaled);
    figure.append(caption, canvas);
    bench.append(figure);
    const made = {...view, figure, canvas, told, scaled, draw: canvas.getContext('2d'), zoom: 1, over: null};
    canvas.addEventListener('pointerdown', event => down(made, event));
    canvas.addEventListener('pointermove', event => move(made, event));
    canvas.addEventListener('pointerup', event => up(made, event));
    canvas.addEventListener('pointercancel', dropped);
    canvas.addEventListener('pointerleave', () => { made.over = null; redraw(); });
    canvas.addEventListener('dblclick', event => {
      const [face] = gripAt(made, pixel(made, event), window.devicePixelRatio || 1)?.faces ?? [];
      if (face) send('side-fit', S.data.key, [made.h, made.v][face.axis], face.side);
    });
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      made.zoom = Math.min(12, Math.max(.4, made.zoom * Math.exp(-event.deltaY * .0015)));
      redraw();
    }, {passive: false});
    new ResizeObserver(redraw).observe(canvas);
    return made;
  });
  activate(0);
  recolor();
  new MutationObserver(recolor).observe(document.documentElement, {attributeFilter: ['data-theme']});
};

/* In a narrow window the crop, the scene or the side views are shown. */
locals.pane = (button, name) => {
  byId('stage').dataset.pane = name;
  for (const one of byId('panes').querySelectorAll('[role=radio]')) one.setAttribute('aria-checked', one === button);
};

/* What the views show: {key, name, size, points, around} as base64 of 16 bit millimetres; null for nothing. */
calls.sides = data => {
  if (!bench) build();
  bench.hidden = !data;
  bench.dataset.of = data?.name || '';
  const other = data?.name !== S.data?.name;
  S.data = data && {...data, points: unpacked(data.points), around: unpacked(data.around)};
  if (other) for (const view of views) view.zoom = 1;
  clearTimeout(S.timer);
  S.timer = 0;
  recolor();
  dropped();
};

/* The server has not taken the last move. */
calls.sidesBack = dropped;

/* Where an edge of a view stands on the screen: for tests that draw by the mouse. */
export const sideEdge = (name, axis, side) => {
  const view = views.find(v => v.name === name), b = view.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  const ring = corners(view, S.box).map(p => onCanvas(view, p));
  const [, , from, to] = FACES.find(f => f[0] === axis && f[1] === side);
  return {x: b.left + (ring[from][0] + ring[to][0]) / 2 / ratio, y: b.top + (ring[from][1] + ring[to][1]) / 2 / ratio, size: S.box.size};
};
