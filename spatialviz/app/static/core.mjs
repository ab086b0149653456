// What the modules of the page share: commands to the server, tables of functions, and elements from HTML.

export const calls = {};   // name -> function(data), called by the server
export const locals = {};  // name -> function(element, argument), by data-local
export const fields = {};  // name -> {input, keydown, blur, focus}(event, element), by data-field

let transmit = () => {};
export const sent = [];    // functions called with each command
export const connect = f => { transmit = f; };
// "name", "name:argument", or a name with its arguments as JSON.
export const send = (said, ...values) => sendAsOf(asked(), said, ...values);
/* A command of somebody who sees this item: a label is changed only while it is still that one. */
export const sendAsOf = (shown, said, ...values) => {
  const [, name, argument] = said.match(/^([^:]*)(?::([^]*))?$/);
  transmit({type: 'command', name, arguments: argument === undefined ? values : [argument], shown});
  for (const hear of sent) hear(said);
};
const asked = () => document.querySelector('#review-item [data-asked]')?.dataset.asked ?? '';
export const go = address => transmit({type: 'go', address});

export const el = (tag, className, text) => {
  const e = document.createElement(tag);
  if (className) e.className = className;
  if (text !== undefined) e.textContent = text;
  return e;
};
export const byId = id => document.getElementById(id);
export const sceneHost = () => byId('tags');
export const sceneWindow = () => byId('view').contentWindow;
export const typing = e => e instanceof Element && (e.matches('textarea, select, [contenteditable]') ||
  (e.tagName === 'INPUT' && !['range', 'checkbox', 'radio', 'button'].includes(e.type)));

// ---- elements from HTML: a node that stays keeps its focus, its caret, its scroll and what is open in it

const style = e => { if (e.dataset.css !== undefined) e.style.cssText = e.dataset.css; };
const woken = root => {
  for (const e of root.querySelectorAll('[data-css]')) style(e);
  if (root.dataset) style(root);
  return root;
};
const alike = (a, b) => a.nodeType === b.nodeType && a.nodeName === b.nodeName && (a.id || '') === (b.id || '');

const morph = (old, made) => {
  if (old.nodeType !== 1) { if (old.nodeValue !== made.nodeValue) old.nodeValue = made.nodeValue; return; }
  if (old.isEqualNode(made)) return;
  for (const {name} of [...old.attributes]) {
    if (!made.hasAttribute(name) && name !== 'style' && !(name === 'open' && old.tagName === 'DETAILS')) old.removeAttribute(name);
  }
  const about = old === document.activeElement && old.tagName === 'INPUT' && old.value === old.defaultValue && old.value;
  for (const {name, value} of made.attributes) if (old.getAttribute(name) !== value) old.setAttribute(name, value);
  // Who is about to type over what was there types over what is there now, and not in front of it.
  if (about && old.value !== about) old.select();
  if (made.dataset.css !== undefined) style(old); else if (old.hasAttribute('style')) old.removeAttribute('style');
  if (old.tagName === 'INPUT' && old !== document.activeElement) {
    if (old.value !== made.value) old.value = made.value;
    old.checked = made.hasAttribute('checked');
  }
  children(old, made);
  if (old.tagName === 'SELECT' && old !== document.activeElement) old.value = made.value;
};

const children = (old, made) => {
  let at = old.firstChild;
  for (const next of [...made.childNodes]) {
    const known = next.id ? [...old.children].find(e => e.id === next.id && e.nodeName === next.nodeName) : null;
    if (known) {
      if (known === at) at = at.nextSibling; else old.insertBefore(known, at);
      morph(known, next);
    } else if (at && alike(at, next)) {
      const after = at.nextSibling;
      morph(at, next);
      at = after;
    } else old.insertBefore(next.nodeType === 1 ? woken(next) : next, at);
  }
  while (at) { const after = at.nextSibling; at.remove(); at = after; }
};

/* One element from its HTML, for those who put it where it belongs themselves. */
export const make = html => woken(parsed(html).firstElementChild);

const parsed = html => { const t = document.createElement('template'); t.innerHTML = html; return t.content; };

// ---- what is selected is marked wherever a row stands for it: the server draws nothing anew

let selected = {};
const mark = () => {
  for (const e of document.querySelectorAll('[data-marked]')) { e.classList.remove('sel'); e.removeAttribute('aria-current'); delete e.dataset.marked; }
  for (const [kind, at] of Object.entries(selected)) {
    if (at === null) continue;
    for (const e of document.querySelectorAll(`[data-do="${kind}:${at}"]`)) {
      e.dataset.marked = '';
      e.classList.add('sel');
      e.setAttribute('aria-current', 'true');
    }
  }
};
calls.selected = now => {
  selected = now;
  mark();
  document.querySelector('#stages tr[data-marked]')?.scrollIntoView({block: 'nearest'});
};

/* True of what somebody may still type into a field of numbers that the next item took away: no keys of the page. */
export const typesOn = e => performance.now() < fieldGone + 1000 && (e.key.length > 1 || /[\d.,+-]/.test(e.key));
let fieldGone = -Infinity;

export const patch = parts => {
  const typed = document.activeElement, before = asked(), changed = typed.dataset?.change && typed.value !== typed.defaultValue;
  for (const [id, html] of parts) {
    const old = byId(id), made = parsed(html).firstElementChild;
    if (!old || !made) continue;
    const shown = old.querySelector('[data-shown]');
    if (alike(old, made)) morph(old, made); else old.replaceWith(woken(made));
    const now = byId(id).matches('[data-shown]') ? byId(id) : byId(id).querySelector('[data-shown]');
    // The item that is judged stays in sight, above the queue that it is from.
    if (now && now !== shown && !now.closest('#review-list')) now.scrollIntoView({block: 'nearest'});
  }
  // Where its field goes, what was typed is sent, and the server says what became of it.
  if (changed && !typed.isConnected) {
    fieldGone = performance.now();
    sendAsOf(before, `${typed.dataset.change}:${typed.value}`);
  }
  mark();
};

// Puts HTML into an element in place of what it holds.
export const fill = (element, html) => {
  const made = element.cloneNode(false);
  made.innerHTML = html;
  children(element, made);
  for (const e of element.querySelectorAll('[data-css]')) style(e);
};
