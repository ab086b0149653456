// The page: its socket, its address, and what elements do by their data (spatialviz/app/markup.py lists it).

import {byId, calls, connect, el, fields, go, locals, patch, send, sendAsOf, sceneWindow, typesOn, typing} from './core.mjs';
import {showScene} from './frame.mjs';
import './drawing.mjs';
import './fields.mjs';
import './frame_grid.mjs';
import './hints.mjs';
import './hover.mjs';
import './inset.mjs';
import './pixels.mjs';
import './rows.mjs';
import './scale.mjs';
import {copyPicture, saveFile} from './shot.mjs';
import './sides.mjs';
import './tags.mjs';
import './timeline.mjs';
import './tip.mjs';

const kept = (name, value) => {
  try { if (value === undefined) return localStorage.getItem(name) || ''; localStorage.setItem(name, value); } catch { return ''; }
};
const id = [...crypto.getRandomValues(new Uint8Array(16))].map(n => n.toString(16).padStart(2, '0')).join('');

// ---- socket: it retries by itself, and the server sends the page as it is then

let socket = null, reached = false, wait = 250, waiting = [];
const transmit = message => {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  else if (message.type === 'command') waiting = [...waiting, message].slice(-20);
};
connect(transmit);

const open = () => {
  // Whatever path a proxy serves the page at.
  socket = new WebSocket(new URL(`app/socket?id=${id}`, location.href.replace('http', 'ws')));
  socket.onopen = () => {
    reached = true;
    transmit({type: 'hello', address: location.search.slice(1), author: kept('author'), theme: document.documentElement.dataset.theme});
    for (const message of waiting.splice(0)) transmit(message);
  };
  socket.onmessage = e => {
    const message = JSON.parse(e.data);
    // A server that is full opens the socket, too, and says only why it is closed again.
    wait = 250;
    document.body.classList.remove('lost');
    if (message.type === 'patch') { patch(message.parts); settle(); }
    else if (message.type === 'call') calls[message.name]?.(message.data);
    else if (message.type === 'address') address(message);
    else if (message.type === 'scene') showScene(message.path);
  };
  socket.onclose = ({code, reason}) => {
    document.body.classList.add('lost');
    const proxied = reached ? '' : `Behind a proxy it needs websockets and --outer-address ${location.origin}${location.pathname} `;
    byId('lost').textContent = code === 1013 && reason ? reason : `The server does not answer. ${proxied}Trying again …`;
    setTimeout(open, wait);
    wait = Math.min(wait * 1.6, 5000);
  };
};

byId('view').addEventListener('load', () => {
  const w = sceneWindow();
  if (!w || !w.location.pathname.includes('/scene/')) return;
  // viser reconnects only while its own document has the focus.
  w.document.hasFocus = () => true;
  // Keys pressed over the scene mean what they mean over the page.
  w.addEventListener('keydown', pressed, true);
  w.addEventListener('copy', copied);
});

// ---- address

let about = '';
const address = ({query, title, push}) => {
  document.title = title;
  // Another answer is read from its head.
  const said = new URLSearchParams(query), now = ['data', 'frame', 'ask'].map(name => said.get(name)).join('\n');
  if (now !== about && document.body.dataset.mode === 'explain') {
    byId('side').scrollTop = 0;
    byId('answer').scrollIntoView({block: 'nearest'});
  }
  if (now !== about) calls.answered();
  about = now;
  const wanted = '?' + query;
  if (location.search !== wanted) history[push ? 'pushState' : 'replaceState'](null, '', wanted);
};
window.addEventListener('popstate', () => go(location.search.slice(1)));

// ---- what elements do

const fraction = (e, at) => {
  const b = e.getBoundingClientRect(), part = (v, low, size) => Math.min(1, Math.max(0, (v - low) / size)).toFixed(5);
  return part(at.clientX, b.left, b.width) + ',' + part(at.clientY, b.top, b.height);
};
const said = (command, value) => send(command + (command.endsWith(':') ? '' : ':') + value);
const act = (e, event) => {
  const own = e.closest('[data-do], [data-local], [data-point]');
  if (!own || own.getAttribute('aria-disabled') === 'true' || own.disabled) return;
  const {do: command, local, point} = own.dataset;
  if (local) { const [name, ...rest] = local.split(':'); locals[name]?.(own, rest.join(':')); }
  if (command) send(command);
  else if (point && !event.shiftKey) said(point, fraction(own, event));
};
document.addEventListener('click', e => { if (e.target instanceof Element) act(e.target, e); });

let live = {}, timers = {};
const follow = (command, value) => {
  live[command] = value;
  timers[command] ||= setTimeout(() => { delete timers[command]; said(command, live[command]); }, 50);
};
document.addEventListener('input', e => {
  const f = e.target, {live: command, field} = f.dataset;
  if (command) {
    if (f.type === 'range') { f.style.setProperty('--v', (f.value - f.min) / (f.max - f.min)); if (f.nextElementSibling?.tagName === 'OUTPUT') f.nextElementSibling.textContent = (+f.value).toFixed(2); }
    follow(command, f.value);
  }
  if (field) fields[field]?.input?.(e, f);
});
document.addEventListener('change', e => {
  const f = e.target, {change, live: command} = f.dataset;
  if (command) { clearTimeout(timers[command]); delete timers[command]; }
  if (change) said(change, f.type === 'checkbox' ? f.checked : f.value);
  // A number, or one of a list, that is taken comes back with the next patch; one that is refused falls back.
  if (change && (f.type === 'number' || f.list)) { const was = f.value; setTimeout(() => { if (f.value === was) f.value = f.defaultValue; }, 900); }
});
for (const kind of ['focus', 'blur']) {
  document.addEventListener(kind, e => { if (e.target.dataset?.field) fields[e.target.dataset.field]?.[kind]?.(e, e.target); }, true);
}
document.addEventListener('pointerdown', e => {
  const pic = e.target instanceof Element && e.target.closest('[data-band]');
  if (!pic || !e.shiftKey) return;
  e.preventDefault();
  const from = fraction(pic, e), band = pic.appendChild(el('div', 'band'));
  const corners = e => [from, fraction(pic, e)].map(t => t.split(',').map(Number));
  pic.setPointerCapture(e.pointerId);
  const move = e => {
    const [a, b] = corners(e);
    [band.style.left, band.style.top] = [0, 1].map(k => 100 * Math.min(a[k], b[k]) + '%');
    [band.style.width, band.style.height] = [0, 1].map(k => 100 * Math.abs(a[k] - b[k]) + '%');
  };
  pic.addEventListener('pointermove', move);
  pic.addEventListener('pointerup', e => {
    pic.removeEventListener('pointermove', move);
    band.remove();
    const [a, b] = corners(e);
    if (Math.abs(a[0] - b[0]) > .004 && Math.abs(a[1] - b[1]) > .004) said(pic.dataset.band, [...a, ...b].map(v => v.toFixed(5)).join(','));
  }, {once: true});
});

// ---- keys

let keys = new Set();
calls.keys = rows => { keys = new Set(rows); };
const named = e => {
  const latin = e.key.length === 1 && e.key.charCodeAt(0) < 128 && !e.altKey;
  const key = latin ? e.key.toUpperCase() : e.code.replace(/^(Key|Digit|Numpad)/, '');
  return (e.altKey ? 'Alt+' : '') + (e.ctrlKey || e.metaKey ? 'Ctrl+' : '') + (e.shiftKey && /^[A-Z]$/.test(key) ? 'Shift+' : '') + key;
};
const pressed = e => {
  const own = e.currentTarget === window, f = document.activeElement, dialog = byId('dialog-window');
  if (e.defaultPrevented || e.isComposing) return;
  // Whoever types into another field by now types there.
  if (!typing(f) && typesOn(e)) { e.preventDefault(); return; }
  if (own && typing(f)) {
    fields[f.dataset.field]?.keydown?.(e, f);
    if (e.defaultPrevented) return;
    // Keys after it are the page's again.
    if (e.key === 'Enter' && f.tagName === 'INPUT' && (f.dataset.enter || !f.closest('dialog'))) {
      if (f.dataset.enter) said(f.dataset.enter, f.value);
      f.blur();
      e.preventDefault();
    }
    if (e.key === 'Escape' && !f.closest('dialog')) { if (f.dataset.enter) f.value = f.defaultValue; f.blur(); e.preventDefault(); }
    return;
  }
  if (dialog) {
    const meant = [...dialog.querySelectorAll('[aria-keyshortcuts]')].find(one => one.getAttribute('aria-keyshortcuts') === named(e));
    if (meant) { e.preventDefault(); meant.click(); }
    return;
  }
  if (own && (e.key === 'Enter' || e.key === ' ') && f.matches('a, button, summary, select, [data-do], [data-local]')) {
    if (!f.matches('a, button, summary, select')) { e.preventDefault(); act(f, e); }
    return;
  }
  const name = named(e), menu = document.querySelector('.menu[open]');
  if (name === 'Escape' && menu) { shut(menu); return; }
  if (name === 'Escape') shutDrawer();
  if (name === 'Escape') byId('stage').removeAttribute('data-swap');
  if (e.key === '/') { e.preventDefault(); byId('ask-text').focus(); byId('ask-text').select(); }
  else if (e.key === '?') { e.preventDefault(); send('help'); }
  // viser's own keys, which move its camera, are without Shift.
  else if (keys.has(name)) {
    e.preventDefault();
    e.stopPropagation();
    // Who holds a key down has not seen what comes up meanwhile.
    if (e.repeat) sendAsOf('', 'key:' + name); else send('key:' + name);
  }
};
window.addEventListener('keydown', pressed);

// Tab stops once at a group; its other members are reached, and chosen, by the arrows.
document.addEventListener('keydown', e => {
  const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[e.key];
  const group = e.target.matches('button') && e.target.closest('[role=radiogroup], [role=tablist], [role=toolbar]');
  if (!step || !group) return;
  const all = [...group.querySelectorAll('button')].filter(one => one.checkVisibility() && !one.disabled);
  const next = all[(all.indexOf(e.target) + step + all.length) % all.length];
  e.preventDefault();
  for (const one of all) one.tabIndex = one === next ? 0 : -1;
  next.focus();
  next.click();
});
locals.skip = () => (document.body.dataset.mode === 'evaluate' ? byId('rows') : document.querySelector('#scene-tools [tabindex="0"]'))?.focus();
// A menu is open until something of it is taken, or something else is done.
const shut = menu => { menu.open = false; menu.querySelector('summary').focus(); };
for (const kind of ['click', 'focusin']) {
  document.addEventListener(kind, e => {
    for (const menu of document.querySelectorAll('.menu[open]')) {
      if (!menu.contains(e.target)) menu.open = false;
      else if (kind === 'click' && e.target.closest('button') && !menu.matches('.stays')) shut(menu);
    }
  });
}

// ---- what the server says beside elements

calls.announce = text => { byId('announced').textContent = ''; setTimeout(() => { byId('announced').textContent = text; }, 100); };

// Until one is chosen the theme is the system's: one that the page does not have already was chosen.
const {dataset: look} = document.documentElement;
calls.theme = name => {
  if (name !== look.theme) kept('chosen-theme', name);
  look.theme = name;
};
matchMedia('(prefers-color-scheme: light)').addEventListener('change', ({matches}) => {
  if (look.given || kept('chosen-theme')) return;
  look.theme = matches ? 'light' : 'dark';
  send('system-theme:' + look.theme);
});
calls.task = name => {
  if (document.body.dataset.mode === name) return;
  document.body.dataset.mode = name;
  shutDrawer();
};
calls.author = name => { kept('author', name); };
calls.toast = ({title, text, bad, undo}) => {
  const note = el('div', 'toast' + (bad ? ' bad' : ''));
  note.append(el('strong', '', title), el('span', '', text));
  // Only what was saved last can be undone.
  document.querySelector('.toast:has(.undo)')?.remove();
  if (undo) Object.assign(note.appendChild(el('button', 'try undo', 'Undo')), {type: 'button', title: 'Ctrl+Z'}).dataset.do = undo;
  const close = note.appendChild(el('button', 'close', '×'));
  close.type = 'button';
  close.setAttribute('aria-label', 'close');
  close.addEventListener('click', () => note.remove());
  // What is said again is said once.
  [...byId('toasts').children].find(one => one.textContent === note.textContent)?.remove();
  byId('toasts').append(note);
  while (byId('toasts').children.length > 4) byId('toasts').firstChild.remove();
  // Why something was not done stays until it is closed; everything is in the log.
  if (!bad) setTimeout(() => note.remove(), undo ? 6000 : 4000 + 60 * text.length);
};
calls.download = ({path, name, copy}) => (copy ? copyPicture : saveFile)(`app/file/${path}?id=${id}`, name);

let working = 0;
calls.working = text => {
  clearTimeout(working);
  // Quick work does not flicker.
  working = setTimeout(() => byId('working').replaceChildren(...(text ? [el('span', '', text)] : [])), text ? 150 : 0);
};

// A dialog is open while its region holds one.
let before = null;
const settle = () => {
  const dialog = byId('dialog-window');
  if (dialog && !dialog.open) {
    before = document.activeElement;
    dialog.showModal();
    dialog.addEventListener('cancel', e => { e.preventDefault(); send('close-dialog'); });
    dialog.addEventListener('click', e => { if (e.target === dialog) send('close-dialog'); });
    dialog.querySelector('[autofocus]')?.select?.();
  }
  if (!dialog && before) { before.focus?.(); before = null; }
};

const shutDrawer = () => {
  if (byId('drawer').classList.contains('closed')) return;
  byId('drawer').classList.add('closed');
  send('drawer:');
};
locals.tab = (_, name) => {
  if (!byId('drawer-tabs').querySelector(`[data-name="${CSS.escape(name)}"]`)) return;
  // What moves boxes goes with the tab that says so.
  if (name !== 'Edit' && byId('drawer-tabs').querySelector('[data-name=Edit][aria-selected=true]')) send('edit-mode:off');
  for (const tab of byId('drawer-tabs').querySelectorAll('[role=tab]')) {
    const own = tab.dataset.name === name;
    tab.setAttribute('aria-selected', own);
    tab.tabIndex = own ? 0 : -1;
    for (const one of tab.getAttribute('aria-controls').split(' ')) byId(one).parentElement.hidden = !own;
  }
  byId('drawer').classList.remove('closed');
  send('drawer:' + name);
};
locals.swap = () => byId('stage').toggleAttribute('data-swap');
calls.tab = name => locals.tab(null, name);
locals.drawer = shutDrawer;
const toldCopied = () => calls.toast({title: 'Copied', text: 'the address of this view'});
locals.share = () => navigator.clipboard?.writeText(location.href).then(toldCopied, () => {});
// Where no text is selected, what is copied is the view.
const copied = e => {
  if (`${getSelection()}` || typing(document.activeElement) || byId('dialog-window')) return;
  e.preventDefault();
  e.clipboardData.setData('text/plain', location.href);
  toldCopied();
};
document.addEventListener('copy', copied);
byId('ask').addEventListener('submit', e => { e.preventDefault(); send('ask:' + byId('ask-text').value); byId('ask-text').blur(); });
calls.question = text => {
  const field = byId('ask-text');
  field.dataset.asked = text;
  if (document.activeElement !== field) field.value = text;
};

open();
