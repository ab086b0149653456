"""What the editor of pixels does in the browser: it draws at once what a hand does, and sends each movement when it ends.

The mask that counts is the core's: it comes back as a picture, and what was
sent but is not answered yet is drawn on top of it.
"""

PIXELS_SCRIPT = r"""
(() => {
if (window.svPixels) return;
const TOOLS = [['select', 'Select', 's'], ['brush', 'Brush', 'b'], ['erase', 'Erase', 'e'], ['polygon', 'Polygon', 'p'], ['rectangle', 'Rectangle', 'r'], ['depth', 'Depth', 'd'], ['cut', 'Cut', 'c']];
const HINTS = {
  select: 'Click an object to draw on it.',
  brush: 'Drag to paint; Shift erases. [ ] or Shift+wheel: size.',
  erase: 'Drag to erase; Shift paints. [ ] or Shift+wheel: size.',
  polygon: 'Click corners; Enter or double click closes (with Shift: removes); Backspace: one back.',
  rectangle: 'Drag a rectangle; Shift removes. F: only the surface inside it.',
  depth: 'Click a surface to add it; Shift removes. [ ]: how alike it must be.',
  cut: 'Draw a line across the object, or around a part of it.',
};
const S = {on: false, view: 'picture', tool: 'brush', radius: .012, tol: .015, surface: false, adds: true, image: null, base: null, pending: [], sent: 0, corners: [], hand: null, at: null, zoom: 1, x: 0, y: 0, fit: 'object', data: {}, armed: false, picture: 'rgb'};
let box = null, canvas, room, tip, raf = 0, draft = document.createElement('canvas'), live = document.createElement('canvas');
const q = s => box.querySelector(s);
const el = (tag, cls, text) => { const e = document.createElement(tag); if (cls) e.className = cls; if (text) e.textContent = text; return e; };
const hotname = (name, key) => { const s = el('span'), i = name.toLowerCase().indexOf(key); if (i < 0) { s.textContent = name; return s; } s.append(name.slice(0, i)); const u = el('u', '', name[i]); s.append(u, name.slice(i + 1)); return s; };
const send = g => { S.sent += 1; S.pending.push({k: S.sent, g}); window.sv('px-draw:' + S.sent + ':' + JSON.stringify(g)); redraw(); };
const clean = () => S.data.steps === 0 && !S.corners.length;

const build = () => {
  box = el('div', 'svpx');
  const top = el('div', 'bar'), tools = el('div', 'bar'), low = el('div', 'bar low');
  const title = el('b', 'title'), field = el('input', 'cls'), list = el('datalist');
  field.type = 'text'; field.placeholder = 'class'; list.id = 'svpxnames'; field.setAttribute('list', 'svpxnames'); field.autocomplete = 'off';
  field.oninput = () => field.classList.remove('miss');
  const views = el('div', 'seg views');
  for (const [k, n, t] of [['picture', 'picture', 'draw on the picture (O)'], ['scene', '3D', 'click surfaces in the scene (O)']]) { const s = el('span', '', n); s.dataset.k = k; s.title = t; s.onclick = () => window.sv('px-view:' + k); views.append(s); }
  const button = (cls, text, title, f) => { const b = el('button', cls, text); b.title = title; b.onclick = f; b.onmousedown = e => e.preventDefault(); return b; };
  const pict = el('div', 'seg pict');
  for (const [k, n] of [['rgb', 'colour'], ['depth', 'depth']]) { const s = el('span', '', n); s.dataset.k = k; s.title = 'I'; s.onclick = () => window.sv('px-picture:' + k); pict.append(s); }
  top.append(title, field, list, views, pict, button('zoom', 'fit', 'whole picture, or the object (0); wheel: zoom; right or Space drag: move', refit), el('span', 'grow'),
    button('back', 'undo', 'take the last step back (Ctrl+Z)', () => window.sv('px-undo')), button('forth', 'redo', 'Ctrl+Y', () => window.sv('px-redo')),
    button('cancel', 'cancel', 'Escape', cancel), button('go', 'apply', 'Enter; Shift+Enter: and go on drawing', e => apply(e.shiftKey)));
  const seg = el('div', 'seg tools');
  for (const [k, n, key] of TOOLS) { const s = hotname(n, key); s.dataset.k = k; s.title = n + ' (' + key.toUpperCase() + ')'; s.onclick = () => tool(k); seg.append(s); }
  const mode = el('div', 'seg mode');
  for (const [k, n] of [['add', 'add'], ['remove', 'remove']]) { const s = el('span', '', n); s.dataset.k = k; s.onclick = () => { S.adds = k === 'add'; show(); tell(); }; mode.append(s); }
  const range = (cls, name, min, max, f) => { const l = el('label', cls, name), i = el('input'), o = el('output'); i.type = 'range'; i.min = min; i.max = max; i.step = 'any'; i.oninput = () => { f(+i.value); show(); }; i.onchange = () => { i.blur(); tell(); }; l.append(i, o); return l; };
  const surf = el('div', 'seg surf'); const f1 = hotname('surface only', 'f'); f1.title = 'only what the depth and colour in the rectangle say (F)'; f1.onclick = () => { S.surface = !S.surface; show(); }; surf.append(f1);
  tools.append(seg, mode, range('size', 'size', -7, -1.6, v => { S.radius = Math.exp(v); }), range('tol', 'alike', Math.log(.001), Math.log(.05), v => { S.tol = Math.exp(v); }), surf,
    button('apart', 'split in depth', 'into the parts that no surface joins (G)', () => window.sv('px-apart')));
  room = el('div', 'room'); canvas = el('canvas'); tip = el('div', 'tip'); room.append(canvas, tip);
  low.append(el('span', 'note'), el('span', 'hint'), el('span', 'grow'), el('span', 'info'));
  box.append(top, tools, room, low);
  canvas.onpointerdown = down; canvas.onpointermove = move; canvas.onpointerup = up; canvas.onpointercancel = up;
  canvas.onpointerleave = () => { S.at = null; tip.style.display = 'none'; redraw(); };
  canvas.ondblclick = e => { e.preventDefault(); if (S.tool === 'polygon') close(e.shiftKey); };
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.addEventListener('wheel', wheel, {passive: false});
  new ResizeObserver(redraw).observe(room);
  for (const k of ['pointerdown', 'pointermove', 'pointerup', 'mousedown', 'mousemove', 'mouseup', 'click', 'dblclick', 'wheel', 'contextmenu', 'touchstart', 'touchmove', 'touchend']) box.addEventListener(k, e => e.stopPropagation());
  window.addEventListener('keydown', e => { if (S.on) keydown(e); }, true);
  window.addEventListener('keyup', e => { if (e.key === 'Shift') redraw(e); if (e.code === 'Space') S.space = false; }, true);
};

const tool = k => { if (k === 'cut' && !S.data.cuttable) { say('A new object cannot be cut before it is applied.'); return; } S.tool = k; S.corners = []; window.sv('px-tool:' + k); show(); };
const say = text => { S.said = text; show(); };
const apply = stay => {
  if (S.corners.length) { close(false); return; }
  const f = q('.cls');
  if (S.data.fresh && !f.value.trim()) { f.classList.add('miss'); f.focus(); say('Which class is it?'); return; }
  window.sv('px-apply:' + JSON.stringify({stay: !!stay, label: S.data.fresh ? f.value.trim() : ''}));
};
const cancel = () => {
  if (S.hand || S.corners.length) { S.hand = null; S.corners = []; S.armed = false; redraw(); return; }
  if (S.data.steps > 0 && !S.armed) { S.armed = true; say(S.data.steps + (S.data.steps === 1 ? ' step is' : ' steps are') + ' not applied: Escape again drops ' + (S.data.steps === 1 ? 'it' : 'them') + '.'); return; }
  window.sv('px-cancel');
};
const close = removes => { const c = S.corners.filter((p, i, a) => !i || p[0] !== a[i - 1][0] || p[1] !== a[i - 1][1]); S.corners = []; if (c.length > 2) send({do: 'polygon', at: c, add: S.adds !== removes}); else redraw(); };

const keydown = e => {
  const a = document.activeElement, typing = a && (a.tagName === 'TEXTAREA' || (a.tagName === 'INPUT' && a.type !== 'range'));
  const own = a && a.classList && a.classList.contains('cls');
  if (typing && !own) return;
  const take = () => { e.preventDefault(); e.stopImmediatePropagation(); };
  if (e.key === 'Enter') { take(); apply(e.shiftKey); return; }
  if (e.key === 'Escape') { take(); if (own) a.blur(); cancel(); return; }
  if (own) { e.stopImmediatePropagation(); return; }
  if (e.ctrlKey || e.metaKey) {
    if (e.key === 'z') { take(); window.sv('px-undo'); }
    else if (e.key === 'y' || (e.key === 'Z' && e.shiftKey)) { take(); window.sv('px-redo'); }
    return;
  }
  const k = e.key.toLowerCase(), found = TOOLS.find(t => t[2] === k);
  if (k === 'o') { take(); window.sv('px-view:' + (S.view === 'scene' ? 'picture' : 'scene')); return; }
  if (e.key === '[' || e.key === ']') { take(); step(e.key === ']' ? 1 : -1); return; }
  if (k === 'shift') { redraw(e); return; }
  if (S.view === 'scene') return;
  if (e.altKey) return;
  take();
  if (found) tool(found[0]);
  else if (k === 'backspace' && S.corners.length) { S.corners.pop(); redraw(); }
  else if (k === 'f') { S.surface = !S.surface; show(); }
  else if (k === 'g') window.sv('px-apart');
  else if (k === 'i') window.sv('px-picture:' + (S.picture === 'rgb' ? 'depth' : 'rgb'));
  else if (k === 'm') { S.adds = !S.adds; show(); }
  else if (k === '0') refit();
  else if (e.code === 'Space') S.space = true;
};
const tell = () => { const h = S.adds + ':' + S.tol.toFixed(5); if (S.view === 'scene' && h !== S.told) { S.told = h; window.sv('px-hand:' + h); } };
const step = d => { if (S.tool === 'depth' || S.view === 'scene') S.tol = Math.min(.05, Math.max(.001, S.tol * Math.pow(1.25, d))); else S.radius = Math.min(.2, Math.max(.0009, S.radius * Math.pow(1.2, d))); show(); tell(); };

const refit = () => { S.fit = S.fit === 'all' && S.data.near ? 'object' : 'all'; redraw(); };
const place = () => {
  const W = room.clientWidth, H = room.clientHeight, w = S.data.w, h = S.data.h;
  const n = S.fit === 'object' && S.data.near;
  if (n) { const [x0, y0, x1, y1] = n; S.zoom = Math.min((W - 16) / (x1 - x0), (H - 16) / (y1 - y0)); S.x = W / 2 - (x0 + x1) / 2 * S.zoom; S.y = H / 2 - (y0 + y1) / 2 * S.zoom; }
  else if (S.fit) { S.zoom = Math.min((W - 16) / w, (H - 16) / h); S.x = (W - w * S.zoom) / 2; S.y = (H - h * S.zoom) / 2; }
};
const where = e => { const b = canvas.getBoundingClientRect(); return [(e.clientX - b.left - S.x) / S.zoom / S.data.w, (e.clientY - b.top - S.y) / S.zoom / S.data.h]; };
const bounded = p => p.map(v => +Math.min(1.5, Math.max(-.5, v)).toFixed(5));
const wheel = e => {
  e.preventDefault();
  if (e.shiftKey) { step(e.deltaY + e.deltaX < 0 ? 1 : -1); return; }
  const b = canvas.getBoundingClientRect(), x = e.clientX - b.left, y = e.clientY - b.top, z = Math.min(60, Math.max(.2, S.zoom * Math.exp(-e.deltaY * .0015)));
  S.x = x - (x - S.x) * z / S.zoom; S.y = y - (y - S.y) * z / S.zoom; S.zoom = z; S.fit = ''; redraw();
};
const down = e => {
  if (!S.image) return;
  if (document.activeElement && document.activeElement.blur) document.activeElement.blur();
  S.armed = false; S.said = '';
  const p = bounded(where(e));
  canvas.setPointerCapture(e.pointerId);
  if (e.button || S.space) { S.hand = {pan: [e.clientX - S.x, e.clientY - S.y]}; return; }
  const t = S.tool;
  if (t === 'select') { window.sv('px-select:' + p.join(',')); return; }
  if (t === 'polygon') { S.corners.push(p); redraw(e); return; }
  if (t === 'depth') { if (p[0] >= 0 && p[0] < 1 && p[1] >= 0 && p[1] < 1) send({do: 'depth', at: [p], add: S.adds !== e.shiftKey, tolerance: +S.tol.toFixed(5)}); return; }
  const add = t === 'rectangle' ? S.adds !== e.shiftKey : (t === 'brush') !== e.shiftKey;
  S.hand = {tool: t, at: [p], add}; redraw(e);
};
const move = e => {
  if (!S.image) return;
  S.at = [e.clientX, e.clientY];
  const h = S.hand;
  if (h && h.pan) { S.x = e.clientX - h.pan[0]; S.y = e.clientY - h.pan[1]; S.fit = ''; }
  else if (h && h.tool === 'rectangle') h.at[1] = bounded(where(e));
  else if (h) for (const c of (e.getCoalescedEvents && e.getCoalescedEvents().length ? e.getCoalescedEvents() : [e])) {
    const p = bounded(where(c)), l = h.at[h.at.length - 1];
    if (h.at.length < 4000 && Math.hypot((p[0] - l[0]) * S.data.w, (p[1] - l[1]) * S.data.h) * Math.max(S.zoom, 1) > 1) h.at.push(p);
  }
  redraw(e);
};
const up = e => {
  const h = S.hand;
  S.hand = null;
  if (!h || h.pan) return;
  if (h.tool === 'brush' || h.tool === 'erase') send({do: 'stroke', at: h.at, add: h.add, radius: +S.radius.toFixed(6)});
  else if (h.at.length > 1 && h.tool === 'rectangle') send({do: S.surface ? 'surface' : 'rectangle', at: h.at, add: h.add});
  else if (h.at.length > 1 && h.tool === 'cut') send({do: 'cut', at: h.at});
  redraw(e);
};

const paint = (c, g, w, h) => {
  c.globalCompositeOperation = g.add === false ? 'destination-out' : 'source-over';
  c.fillStyle = c.strokeStyle = S.data.color; c.lineCap = c.lineJoin = 'round';
  const xy = p => [p[0] * w, p[1] * h];
  if (g.do === 'stroke') {
    const r = Math.max(.71, g.radius * w);
    if (g.at.length < 2) { c.beginPath(); c.arc(...xy(g.at[0]), r, 0, 7); c.fill(); }
    else { c.lineWidth = 2 * r; c.beginPath(); g.at.forEach((p, i) => i ? c.lineTo(...xy(p)) : c.moveTo(...xy(p))); c.stroke(); }
  } else if (g.do === 'polygon') { c.beginPath(); g.at.forEach((p, i) => i ? c.lineTo(...xy(p)) : c.moveTo(...xy(p))); c.fill('evenodd'); }
  else if (g.do === 'rectangle') { const [a, b] = g.at.map(xy); c.fillRect(a[0], a[1], b[0] - a[0], b[1] - a[1]); }
  c.globalCompositeOperation = 'source-over';
};
const redraw = e => { if (e && e.shiftKey !== undefined) S.shift = e.shiftKey; if (!raf) raf = requestAnimationFrame(() => { raf = 0; if (S.on && S.view === 'picture' && box && S.image) frame(); }); };
const frame = () => {
  place();
  const d = S.data, ratio = window.devicePixelRatio || 1, W = room.clientWidth, H = room.clientHeight, w = d.w, h = d.h;
  if (canvas.width !== Math.round(W * ratio) || canvas.height !== Math.round(H * ratio)) { canvas.width = Math.round(W * ratio); canvas.height = Math.round(H * ratio); }
  const c = canvas.getContext('2d');
  c.setTransform(ratio, 0, 0, ratio, 0, 0); c.clearRect(0, 0, W, H);
  c.imageSmoothingEnabled = S.zoom < 2.5;
  c.drawImage(S.image, S.x, S.y, w * S.zoom, h * S.zoom);
  if (draft.width !== w || draft.height !== h) { draft.width = w; draft.height = h; }
  const m = draft.getContext('2d');
  m.clearRect(0, 0, w, h);
  if (S.base) m.drawImage(S.base, 0, 0);
  for (const p of S.pending) paint(m, p.g, w, h);
  const g = S.hand;
  if (g && (g.tool === 'brush' || g.tool === 'erase')) paint(m, {do: 'stroke', at: g.at, add: g.add, radius: S.radius}, w, h);
  c.imageSmoothingEnabled = false;
  c.globalAlpha = .42; c.drawImage(draft, S.x, S.y, w * S.zoom, h * S.zoom); c.globalAlpha = 1;
  if (live.width !== canvas.width || live.height !== canvas.height) { live.width = canvas.width; live.height = canvas.height; }
  const o = live.getContext('2d');
  o.setTransform(ratio, 0, 0, ratio, 0, 0); o.globalCompositeOperation = 'source-over'; o.clearRect(0, 0, W, H); o.imageSmoothingEnabled = false;
  for (const [a, b] of [[1.2, 0], [-1.2, 0], [0, 1.2], [0, -1.2]]) o.drawImage(draft, S.x + a, S.y + b, w * S.zoom, h * S.zoom);
  o.globalCompositeOperation = 'destination-out'; o.drawImage(draft, S.x, S.y, w * S.zoom, h * S.zoom);
  c.setTransform(1, 0, 0, 1, 0, 0); c.drawImage(live, 0, 0); c.setTransform(ratio, 0, 0, ratio, 0, 0);
  const X = v => S.x + v * S.zoom, Y = v => S.y + v * S.zoom;
  const path = (at, shut) => { c.beginPath(); at.forEach((p, i) => i ? c.lineTo(X(p[0] * w), Y(p[1] * h)) : c.moveTo(X(p[0] * w), Y(p[1] * h))); if (shut) c.closePath(); };
  let named = null;
  const b = canvas.getBoundingClientRect(), over = S.at && [S.at[0] - b.left, S.at[1] - b.top];
  c.lineWidth = 1;
  for (const t of d.others || []) {
    c.beginPath();
    for (const line of t.lines) { line.forEach((v, i) => i % 2 ? 0 : i ? c.lineTo(X(v), Y(line[i + 1])) : c.moveTo(X(v), Y(line[i + 1]))); c.closePath(); }
    c.strokeStyle = 'rgba(0,0,0,.5)'; c.lineWidth = 2; c.stroke(); c.strokeStyle = S.tool === 'select' ? 'rgba(255,255,255,.85)' : 'rgba(255,255,255,.4)'; c.lineWidth = 1; c.stroke();
    if (S.tool === 'select' && over && c.isPointInPath(over[0] * ratio, over[1] * ratio) && (!named || t.size < named.size)) named = t;
  }
  tip.style.display = named ? 'block' : 'none';
  if (named) { tip.textContent = named.name; tip.style.left = over[0] + 'px'; tip.style.top = over[1] + 'px'; }
  c.strokeStyle = d.color; c.lineWidth = 1.6;
  for (const l of d.edges || []) { c.beginPath(); c.moveTo(X(l[0]), Y(l[1])); c.lineTo(X(l[2]), Y(l[3])); c.stroke(); }
  const edge = () => { c.strokeStyle = 'rgba(0,0,0,.75)'; c.lineWidth = 3; c.stroke(); c.strokeStyle = '#fff'; c.lineWidth = 1.3; c.stroke(); };
  if (S.corners.length) { path(S.corners); if (over) c.lineTo(over[0], over[1]); edge(); for (const p of S.corners) { c.fillStyle = '#fff'; c.fillRect(X(p[0] * w) - 2.5, Y(p[1] * h) - 2.5, 5, 5); } }
  if (g && g.tool === 'cut') { path(g.at); edge(); }
  if (g && g.tool === 'rectangle' && g.at[1]) { const [p, r] = g.at; c.beginPath(); c.rect(X(p[0] * w), Y(p[1] * h), (r[0] - p[0]) * w * S.zoom, (r[1] - p[1]) * h * S.zoom); edge(); }
  if (over && (S.tool === 'brush' || S.tool === 'erase')) { c.beginPath(); c.arc(over[0], over[1], Math.max(.71, S.radius * w) * S.zoom, 0, 7); edge(); if ((S.tool === 'erase') !== !!S.shift) { c.beginPath(); c.moveTo(over[0] - 4, over[1]); c.lineTo(over[0] + 4, over[1]); edge(); } }
  canvas.style.cursor = S.tool === 'select' ? 'pointer' : S.tool === 'brush' || S.tool === 'erase' ? 'none' : 'crosshair';
};

const show = () => {
  if (!box) return;
  const d = S.data, scene = S.view === 'scene';
  box.classList.toggle('slim', scene);
  q('.title').textContent = d.title || '';
  q('.cls').style.display = d.fresh ? '' : 'none';
  for (const s of box.querySelectorAll('.views span')) s.classList.toggle('on', s.dataset.k === S.view);
  for (const s of box.querySelectorAll('.tools span[data-k]')) s.classList.toggle('on', s.dataset.k === S.tool);
  for (const s of box.querySelectorAll('.mode span')) s.classList.toggle('on', (s.dataset.k === 'add') === S.adds);
  for (const s of box.querySelectorAll('.pict span')) s.classList.toggle('on', s.dataset.k === S.picture);
  q('.surf span').classList.toggle('on', S.surface);
  const seen = (s, on) => { q(s).style.display = on ? '' : 'none'; };
  seen('.tools', !scene); seen('.pict', !scene); seen('.zoom', !scene);
  seen('.size', !scene && (S.tool === 'brush' || S.tool === 'erase')); seen('.tol', scene || S.tool === 'depth'); seen('.surf', !scene && S.tool === 'rectangle'); seen('.apart', !scene && S.tool === 'cut');
  seen('.mode', scene || S.tool === 'polygon' || S.tool === 'rectangle' || S.tool === 'depth');
  q('.size input').value = Math.log(S.radius); q('.size output').textContent = (2 * Math.max(.71, S.radius * (d.w || 640))).toFixed(1) + ' px';
  q('.tol input').value = Math.log(S.tol); q('.tol output').textContent = S.tol >= .03 ? 'to edges' : (100 * S.tol).toFixed(1) + ' %';
  q('.back').disabled = !d.back; q('.forth').disabled = !d.forth;
  q('button.go').textContent = d.parts > 1 ? 'apply ' + d.parts + ' parts' : 'apply'; q('button.go').disabled = !(d.steps > 0);
  const note = q('.low .note'); note.textContent = S.said || d.said || ''; note.className = 'note' + ((S.said || d.bad) ? ' bad' : '');
  q('.low .hint').textContent = note.textContent ? '' : scene ? 'Click surfaces of the object in the scene.' : HINTS[S.tool];
  q('.low .info').textContent = d.info || '';
  redraw();
};
window.svPixelsPicture = p => { S.picture = p.kind; const i = new Image(); i.onload = () => { S.image = i; redraw(); }; i.src = p.url; };
window.svPixelsPlace = () => ({x: S.x, y: S.y, w: S.data.w, h: S.data.h, zoom: S.zoom});
window.svPixels = d => {
  const opened = d.on && !S.on, other = d.key !== S.data.key;
  S.on = d.on;
  if (!d.on) { if (box) box.remove(); S.data = {}; S.pending = []; S.corners = []; S.hand = null; return; }
  if (!box) build();
  const parent = window.__viserMutable.canvas.parentElement.parentElement;
  if (box.parentElement !== parent) parent.appendChild(box);
  if (other) { S.armed = false; S.said = ''; S.corners = []; S.hand = null; S.pending = []; q('.cls').value = d.label || ''; q('.cls').classList.remove('miss'); S.adds = true; S.surface = d.fresh; if (opened) S.fit = d.near ? 'object' : 'all'; }
  if (other || d.steps !== S.data.steps || d.said !== S.data.said) { S.said = ''; S.armed = false; }
  if (d.names && q('datalist').dataset.n !== d.names.join()) { q('datalist').dataset.n = d.names.join(); q('datalist').replaceChildren(...d.names.map(n => { const o = el('option'); o.value = n; return o; })); }
  S.data = d; S.view = d.view; S.tool = d.tool;
  S.pending = S.pending.filter(p => p.k > d.seen);
  if (d.fresh && d.view === 'scene' && opened) q('.cls').focus();
  const i = new Image(); i.onload = () => { if (S.data === d) { S.base = i; redraw(); } }; i.src = d.mask;
  show(); tell();
};
})()
"""
