/* The editor of pixels: it draws at once what a hand does, and sends each movement when it ends.
The mask that counts is the core's: it comes back as a picture, and what was sent but is not answered yet is drawn
on top of it. It lies over the scene. */

import {calls, el, sceneHost, send} from './core.mjs';
import {button, choice, hotName, range} from './controls.mjs';
import {HINTS, LEAST_RADIUS, TOOLS, draw} from './pixels_draw.mjs';

/* radius and tol as fractions of the picture's width and of the depth; corners and hands as fractions of the picture;
   x, y, zoom: where the picture lies in the canvas. */
const S = {
  on: false, tool: 'brush', radius: 0.012, tol: 0.015, surface: false, adds: true, image: null,
  base: null, pending: [], sent: 0, corners: [], hand: null, at: null, zoom: 1, x: 0, y: 0, fit: 'object', data: {},
  armed: false, picture: 'rgb', shift: false, space: false, said: '',
};
let box = null, canvas, room, tip, classes, waiting = 0;

const q = selector => box.querySelector(selector);
const between = (v, low, high) => Math.min(high, Math.max(low, v));
const steps = n => `${n} ${n === 1 ? 'step' : 'steps'}`;

function gesture(made) {
  S.sent += 1;
  S.pending.push({k: S.sent, gesture: made});
  send('px-draw', S.sent, made);
  // What is outlined at once is named next.
  if (S.data.fresh && made.do !== 'stroke') q('.cls').focus();
  redraw();
}

/* ---- what stands there */

const press = (className, key) => {
  for (const one of q(`.${className}`).children) one.setAttribute('aria-pressed', String(one.dataset.k === key));
};

function build() {
  box = el('section', 'pixels');
  box.setAttribute('aria-label', 'Editor of pixels');
  const top = el('div', 'tools-row'), tools = el('div', 'tools-row strokes'), low = el('div', 'tools-row low');
  const field = el('input', 'cls'), names = el('datalist');
  Object.assign(field, {type: 'text', placeholder: 'class', ariaLabel: 'class', autocomplete: 'off'});
  names.id = 'pixel-names';
  field.setAttribute('list', names.id);
  field.addEventListener('input', () => field.classList.remove('miss'));
  top.append(
    el('b', 'title'), field, names,
    choice('pict', 'picture', [['rgb', 'colour', 'I'], ['depth', 'depth', 'I']], kind => send(`px-picture:${kind}`)),
    button('try zoom', 'fit', 'whole picture, or the object (0); wheel: zoom; right or Space drag: move', refit),
    el('span', 'grow'),
    button('try back', 'undo', 'take the last step back (Ctrl+Z)', () => send('px-undo')),
    button('try forth', 'redo', 'bring it back (Ctrl+Y)', () => send('px-redo')),
    button('try cancel', 'cancel', 'Escape', cancel),
    button('go apply', 'apply', 'Enter; Shift+Enter: and go on drawing', event => apply(event.shiftKey)),
  );
  const surface = el('div', 'seg surf');
  surface.append(hotName(
    button('', '', 'only what the depth and colour in the rectangle say (F)', toggleSurface), 'surface only', 'f'));
  tools.append(
    choice('pens', 'tools', TOOLS.map(([tool, name, key]) => [tool, name, `${name} (${key.toUpperCase()})`]), take,
      Object.fromEntries(TOOLS.map(([tool, , key]) => [tool, key]))),
    choice('adding', 'add or remove', [['add', 'add', 'M'], ['remove', 'remove', 'M']], mode => adds(mode === 'add')),
    range('size', 'size', -7, -1.6, v => { S.radius = Math.exp(v); show(); }),
    range('tol', 'alike', Math.log(0.001), Math.log(0.05), v => { S.tol = Math.exp(v); show(); }),
    surface,
    button('try apart', 'split in depth', 'into the parts that no surface joins (G)', () => send('px-apart')),
  );
  canvas = el('canvas');
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', 'the picture with the mask that is drawn');
  tip = el('div', 'tip');
  tip.hidden = true;
  room = el('div', 'room');
  classes = el('div', 'classes');
  classes.setAttribute('role', 'group');
  classes.setAttribute('aria-label', 'Class by its digit');
  room.append(canvas, tip, classes);
  low.append(el('span', 'note'), el('span', 'hint'), el('span', 'grow'), el('span', 'info'));
  low.setAttribute('role', 'status');
  box.append(top, tools, room, low);
  canvas.addEventListener('pointerdown', down);
  canvas.addEventListener('pointermove', move);
  canvas.addEventListener('pointerup', up);
  canvas.addEventListener('pointercancel', up);
  canvas.addEventListener('pointerleave', () => {
    S.at = null;
    tip.hidden = true;
    redraw();
  });
  canvas.addEventListener('dblclick', event => {
    event.preventDefault();
    if (S.tool === 'polygon') close(event.shiftKey);
  });
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  canvas.addEventListener('wheel', wheel, {passive: false});
  new ResizeObserver(() => redraw()).observe(room);
}

function show() {
  if (!box) return;
  const d = S.data, {tool} = S;
  q('.title').textContent = d.title || '';
  q('.title').title = d.title || '';
  press('pens', tool);
  press('adding', S.adds ? 'add' : 'remove');
  press('pict', S.picture);
  q('.surf button').setAttribute('aria-pressed', String(S.surface));
  const seen = {
    '.cls': d.fresh,
    '.size': tool === 'brush' || tool === 'erase',
    '.tol': tool === 'depth',
    '.surf': tool === 'rectangle',
    '.apart': tool === 'cut',
    '.adding': ['polygon', 'rectangle', 'depth', 'segment'].includes(tool),
  };
  for (const [selector, on] of Object.entries(seen)) q(selector).hidden = !on;
  q('[data-k=segment]').hidden = !d.segments;
  q('.size input').value = Math.log(S.radius);
  q('.size output').textContent = `${(2 * Math.max(LEAST_RADIUS, S.radius * (d.w || 640))).toFixed(1)} px`;
  q('.tol input').value = Math.log(S.tol);
  q('.tol output').textContent = S.tol >= 0.03 ? 'to edges' : `${(100 * S.tol).toFixed(1)} %`;
  q('.back').disabled = !d.back;
  q('.forth').disabled = !d.forth;
  q('.apply').textContent = d.parts > 1 ? `apply ${d.parts} parts` : 'apply';
  q('.apply').disabled = !(d.steps > 0);
  const note = q('.low .note');
  note.textContent = note.title = S.said || d.said || '';
  note.classList.toggle('bad', Boolean(S.said || d.bad));
  const hint = HINTS[tool];
  q('.low .hint').textContent = q('.low .hint').title = note.textContent ? '' : hint;
  q('.low .info').textContent = d.info || '';
  redraw();
}

/* ---- what it does */

function say(text) {
  S.said = text;
  show();
}

function take(tool) {
  if (tool === 'cut' && !S.data.cuttable) {
    say('A new object cannot be cut before it is applied.');
    return;
  }
  S.tool = tool;
  S.corners = [];
  send(`px-tool:${tool}`);
  show();
}

function adds(yes) {
  S.adds = yes;
  show();
}

function toggleSurface() {
  S.surface = !S.surface;
  show();
}

function resize(by) {
  if (S.tool === 'depth') S.tol = between(S.tol * 1.25 ** by, 0.001, 0.05);
  else S.radius = between(S.radius * 1.2 ** by, 0.0009, 0.2);
  show();
}

function apply(stay) {
  if (S.corners.length) {
    close(false);
    return;
  }
  const field = q('.cls'), label = S.data.fresh ? field.value.trim() : '';
  if (S.data.fresh && !label) {
    field.classList.add('miss');
    field.focus();
    say('Which class is it?');
    return;
  }
  send('px-apply', Boolean(stay), label);
}

/* A new thing is named by a digit, beside what was drawn of it. */
function nameBy(digit) {
  const name = S.data.drawn && S.data.digits[digit - 1];
  if (!name) return false;
  q('.cls').value = name;
  apply(false);
  return true;
}

function besideDrawn() {
  const at = S.data.drawn, {w, h} = S.data;
  classes.hidden = !at;
  if (!at) return;
  const low = (v, most) => between(v, 4, Math.max(4, most - 4));
  const x = Math.min(at[2], w) * S.zoom + S.x + 12, y = Math.max(0, Math.min(at[1], h)) * S.zoom + S.y;
  classes.style.translate = `${low(x, room.clientWidth - classes.offsetWidth)}px ${low(y, room.clientHeight - classes.offsetHeight)}px`;
}

function cancel() {
  const undone = S.data.kept ? 0 : S.data.steps;
  if (S.hand || S.corners.length) {
    Object.assign(S, {hand: null, corners: [], armed: false});
    redraw();
  } else if (undone > 0 && !S.armed) {
    S.armed = true;
    say(`${steps(undone)} ${undone === 1 ? 'is' : 'are'} not applied: Escape again drops ${undone === 1 ? 'it' : 'them'}.`);
  } else send('px-cancel');
}

function close(removes) {
  const at = S.corners.filter((p, i, all) => !i || p[0] !== all[i - 1][0] || p[1] !== all[i - 1][1]);
  S.corners = [];
  if (at.length > 2) gesture({do: 'polygon', at, add: S.adds !== removes});
  else redraw();
}

function keydown(event) {
  if (!S.on || document.querySelector('dialog[open]')) return;
  const active = document.activeElement;
  const typing = active && (active.matches('textarea, select') || (active.tagName === 'INPUT' && active.type !== 'range'));
  const own = active === q('.cls');
  if (typing && !own) return;
  const taken = () => {
    event.preventDefault();
    event.stopImmediatePropagation();
  };
  const key = event.key.toLowerCase();
  if (key === 'enter' && !(active?.tagName === 'BUTTON')) {
    taken();
    apply(event.shiftKey);
  } else if (key === 'escape') {
    taken();
    if (own) active.blur();
    cancel();
  } else if (/^[1-9]$/.test(key) && (!own || !active.value) && nameBy(+key)) taken();
  else if (own) event.stopImmediatePropagation();
  else if (event.ctrlKey || event.metaKey) {
    const undoes = {z: event.shiftKey ? 'px-redo' : 'px-undo', y: 'px-redo'}[key];
    if (!undoes) return;
    taken();
    send(undoes);
  } else if (key === '[' || key === ']') {
    taken();
    resize(key === ']' ? 1 : -1);
  } else if (key === 'shift') redraw(event);
  else if (!event.altKey && !['tab', 'enter'].includes(key)) {
    if (key === ' ' && active?.tagName === 'BUTTON') return;
    taken();
    drawingKey(event, key);
  }
}

function drawingKey(event, key) {
  const found = TOOLS.find(([tool, , hot]) => hot === key && (tool !== 'segment' || S.data.segments));
  if (found) take(found[0]);
  else if (key === 'backspace' && S.corners.length) {
    S.corners.pop();
    redraw();
  } else if (key === 'f') toggleSurface();
  else if (key === 'g') send('px-apart');
  else if (key === 'i') send(`px-picture:${S.picture === 'rgb' ? 'depth' : 'rgb'}`);
  else if (key === 'm') adds(!S.adds);
  else if (key === '0') refit();
  else if (event.code === 'Space') S.space = true;
}

function keyup(event) {
  if (event.key === 'Shift') redraw(event);
  if (event.code === 'Space') S.space = false;
}

window.addEventListener('keydown', keydown, true);
window.addEventListener('keyup', keyup, true);
/* ---- the hand on the picture */

function refit() {
  S.fit = S.fit === 'all' && S.data.near ? 'object' : 'all';
  redraw();
}

function place() {
  const W = room.clientWidth, H = room.clientHeight, {w, h} = S.data;
  const near = S.fit === 'object' && S.data.near;
  if (!near && !S.fit) return;
  const [x0, y0, x1, y1] = near || [0, 0, w, h];
  S.zoom = Math.min((W - 16) / (x1 - x0), (H - 16) / (y1 - y0));
  S.x = W / 2 - ((x0 + x1) / 2) * S.zoom;
  S.y = H / 2 - ((y0 + y1) / 2) * S.zoom;
}

const inCanvas = event => {
  const b = canvas.getBoundingClientRect();
  return [event.clientX - b.left, event.clientY - b.top];
};

/* Where an event is on the picture, as fractions of its width and height, a little beyond it at most. */
function where(event) {
  const [x, y] = inCanvas(event);
  return [(x - S.x) / S.zoom / S.data.w, (y - S.y) / S.zoom / S.data.h].map(v => +between(v, -0.5, 1.5).toFixed(5));
}

function wheel(event) {
  event.preventDefault();
  if (event.shiftKey) {
    resize(event.deltaY + event.deltaX < 0 ? 1 : -1);
    return;
  }
  const [x, y] = inCanvas(event), zoom = between(S.zoom * Math.exp(-event.deltaY * 0.0015), 0.2, 60);
  S.x = x - ((x - S.x) * zoom) / S.zoom;
  S.y = y - ((y - S.y) * zoom) / S.zoom;
  Object.assign(S, {zoom, fit: ''});
  redraw();
}

function down(event) {
  if (!S.image) return;
  document.activeElement?.blur?.();
  Object.assign(S, {armed: false, said: ''});
  const p = where(event), {tool} = S;
  canvas.setPointerCapture(event.pointerId);
  if (event.button || S.space) S.hand = {pan: [event.clientX - S.x, event.clientY - S.y]};
  else if (tool === 'select') send(`px-select:${p.join(',')}`);
  else if (tool === 'polygon') S.corners.push(p);
  else if (tool === 'segment') gesture({do: 'segment', at: [p], add: S.adds !== event.shiftKey});
  else if (tool === 'depth') {
    const inside = p.every(v => v >= 0 && v < 1);
    if (inside) gesture({do: 'depth', at: [p], add: S.adds !== event.shiftKey, tolerance: +S.tol.toFixed(5)});
  } else {
    const add = (tool === 'rectangle' ? S.adds : tool === 'brush') !== event.shiftKey;
    S.hand = {tool, at: [p], add};
  }
  redraw(event);
}

function move(event) {
  if (!S.image) return;
  S.at = [event.clientX, event.clientY];
  const {hand} = S;
  if (hand?.pan) Object.assign(S, {x: event.clientX - hand.pan[0], y: event.clientY - hand.pan[1], fit: ''});
  else if (hand?.tool === 'rectangle') hand.at[1] = where(event);
  else if (hand) {
    const all = event.getCoalescedEvents?.() ?? [];
    for (const one of all.length ? all : [event]) {
      const p = where(one), last = hand.at.at(-1);
      const far = Math.hypot((p[0] - last[0]) * S.data.w, (p[1] - last[1]) * S.data.h) * Math.max(S.zoom, 1) > 1;
      if (far && hand.at.length < 4000) hand.at.push(p);
    }
  }
  redraw(event);
}

function up(event) {
  const {hand} = S;
  S.hand = null;
  if (!hand || hand.pan) return;
  const {tool, at, add} = hand;
  if (tool === 'brush' || tool === 'erase') gesture({do: 'stroke', at, add, radius: +S.radius.toFixed(6)});
  else if (at.length > 1 && tool === 'rectangle') gesture({do: S.surface ? 'surface' : 'rectangle', at, add});
  else if (at.length > 1 && tool === 'cut') gesture({do: 'cut', at});
  redraw(event);
}

function redraw(event) {
  if (event?.shiftKey !== undefined) S.shift = event.shiftKey;
  waiting ||= requestAnimationFrame(() => {
    waiting = 0;
    if (!S.on || !S.image) return;
    place();
    besideDrawn();
    const over = S.at && inCanvas({clientX: S.at[0], clientY: S.at[1]});
    const named = draw(canvas, S, over);
    tip.hidden = !named;
    if (named) {
      tip.textContent = named.name;
      tip.style.transform = `translate(${over[0] + 12}px, ${over[1] + 12}px)`;
    }
    canvas.style.cursor = {select: 'pointer', brush: 'none', erase: 'none'}[S.tool] ?? 'crosshair';
  });
}

/* ---- what the server says */

function picture(url, come) {
  const image = new Image();
  image.addEventListener('load', () => come(image));
  image.src = url;
}

/* The picture to draw on: {kind: 'rgb' or 'depth', url}. */
calls.pixelsPicture = ({kind, url}) => {
  S.picture = kind;
  picture(url, image => {
    S.image = image;
    redraw();
  });
};

/* Where the picture lies in the canvas, and how large it is drawn: for tests that draw by the mouse. */
export const pixelsPlace = () => ({x: S.x, y: S.y, w: S.data.w, h: S.data.h, zoom: S.zoom});
calls.pixelsPlace = pixelsPlace;

/* The state of what is drawn, as the server has it; `{on: false}` closes the editor. */
calls.pixels = data => {
  const opened = data.on && !S.on, other = data.key !== S.data.key;
  S.on = data.on;
  if (!data.on) {
    box?.remove();
    Object.assign(S, {data: {}, pending: [], corners: [], hand: null});
    return;
  }
  if (!box) build();
  if (box.parentElement !== sceneHost()) sceneHost().append(box);
  if (other) {
    Object.assign(S, {corners: [], hand: null, pending: [], adds: true, surface: data.fresh});
    q('.cls').value = data.label || '';
    q('.cls').classList.remove('miss');
    if (opened) S.fit = data.near ? 'object' : 'all';
  }
  if (other || data.steps !== S.data.steps || data.said !== S.data.said) Object.assign(S, {said: '', armed: false});
  const names = q('datalist'), known = (data.names ?? []).join();
  if (data.names && names.dataset.known !== known) {
    names.dataset.known = known;
    names.replaceChildren(...data.names.map(name => Object.assign(el('option'), {value: name})));
  }
  Object.assign(S, {data, tool: data.tool});
  const offered = (data.drawn ? data.digits : []).join();
  if (classes.dataset.of !== offered) {
    classes.dataset.of = offered;
    classes.replaceChildren(...(data.drawn ? data.digits : []).map((name, k) => {
      const one = button('try', '', `it is a ${name}`, () => nameBy(k + 1));
      one.append(el('kbd', '', k + 1), name);
      return one;
    }));
  }
  S.pending = S.pending.filter(({k}) => k > data.seen);
  picture(data.mask, image => {
    if (S.data !== data) return;
    S.base = image;
    redraw();
  });
  show();
};
