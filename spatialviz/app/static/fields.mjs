/* Text fields with a list of their own, and what dialogs do in the browser: `fields`, and some `locals` and `calls`.

A field that an element names by data-field gets its events from page.mjs. A key that is used up here is
`defaultPrevented`: whoever comes after leaves it alone. The commands that are sent: `ask-typed:`, `ask:`,
`class-typed:`, `class:`, `complete:`, `find:`. */

import {byId, calls, el, fields, fill, locals, send} from './core.mjs';

const TYPED_MS = 60, COMPLETE_MS = 90;

/* One list of offers for the field that is typed in. It lies in the top layer, so that nothing cuts it. */
const offered = {field: null, list: null, rows: [], at: -1, take: null};

const isOpen = field => offered.field === field && offered.rows.length > 0;

function close() {
  const {field, list} = offered;
  if (list?.matches(':popover-open')) list.hidePopover();
  if (field) {
    field.setAttribute('aria-expanded', 'false');
    field.removeAttribute('aria-activedescendant');
  }
  Object.assign(offered, {field: null, rows: [], at: -1});
}

function activate(at) {
  const {field, rows} = offered;
  rows.forEach((row, i) => row.setAttribute('aria-selected', String(i === at)));
  offered.at = at;
  if (at < 0) field.removeAttribute('aria-activedescendant');
  else {
    field.setAttribute('aria-activedescendant', rows[at].id);
    rows[at].scrollIntoView({block: 'nearest'});
  }
}

/* Shows offers ({value, parts: [[tag, class, text], ...]}) below a field; `take(offer, done)` is called with the one
   that is taken, `done` where it was pressed or entered and not only completed. */
function open(field, offers, note, take) {
  // What the arrows chose stays chosen where it is offered again.
  const chosen = isOpen(field) ? offered.rows[offered.at]?.offer.value : undefined;
  close();
  if (!offers.length && !note) return;
  const list = offered.list ??= Object.assign(el('div', 'suggestions-list'), {id: 'suggested', popover: 'manual'});
  const parent = field.closest('dialog') ?? document.body;
  if (list.parentElement !== parent) parent.append(list);
  list.setAttribute('role', 'listbox');
  list.setAttribute('aria-label', 'suggestions');
  const rows = offers.map((offer, i) => {
    const row = el('div', 'offer');
    row.id = `suggested-${i}`;
    row.setAttribute('role', 'option');
    row.setAttribute('aria-selected', 'false');
    row.append(...offer.parts.filter(part => part[2]).map(part => el(...part)));
    /* A press takes the focus at mousedown: the field keeps it. */
    row.addEventListener('mousedown', event => {
      event.preventDefault();
      take(offer, true);
    });
    row.offer = offer;
    return row;
  });
  list.replaceChildren(...(note ? [el('p', 'warned', note)] : []), ...rows);
  const box = field.getBoundingClientRect();
  const below = innerHeight - box.bottom, above = below < 200 && box.top > below;
  list.style.left = `${box.left}px`;
  list.style.width = `${box.width}px`;
  list.style.top = above ? 'auto' : `${box.bottom + 4}px`;
  list.style.bottom = above ? `${innerHeight - box.top + 4}px` : 'auto';
  list.style.maxHeight = `${Math.min(360, (above ? box.top : below) - 12)}px`;
  list.showPopover();
  field.setAttribute('role', 'combobox');
  field.setAttribute('aria-controls', 'suggested');
  field.setAttribute('aria-autocomplete', 'list');
  field.setAttribute('aria-expanded', 'true');
  Object.assign(offered, {field, rows, at: -1, take});
  const at = rows.findIndex(row => row.offer.value === chosen);
  if (at >= 0) activate(at);
}

/* The keys of a list that is open; whether the key was one. */
function listKey(event, field) {
  if (!isOpen(field)) return false;
  const {rows, at, take} = offered;
  const steps = {ArrowDown: 1, ArrowUp: -1};
  if (event.key in steps) {
    const from = at < 0 && event.key === 'ArrowUp' ? 0 : at;
    activate((from + steps[event.key] + rows.length) % rows.length);
  } else if (event.key === 'Enter' && at >= 0) take(rows[at].offer, true);
  else if (event.key === 'Tab' && !event.shiftKey) take(rows[Math.max(at, 0)].offer, false);
  else if (event.key === 'Escape') close();
  else return false;
  event.preventDefault();
  event.stopPropagation();
  return true;
}

function leave(event, field, value) {
  event.preventDefault();
  event.stopPropagation();
  clearTimeout(timer);
  close();
  if (value !== undefined) field.value = value;
  field.blur();
}

let timer = 0;
function soon(message, field, wait = TYPED_MS) {
  clearTimeout(timer);
  timer = setTimeout(() => send(message + field.value), wait);
}

const fieldOf = name => document.querySelector(`input[data-field="${name}"]`);

function focus(field) {
  field?.focus();
  field?.select();
}

/* Ask: names of this frame, relations, recent questions. */

/* Where in `typed` begins what an offer completes: its longest ending that the offer begins with, else the last word. */
export function begunAt(typed, text) {
  for (const {index} of typed.matchAll(/(?<!\S)\S/g)) {
    if (text.toLowerCase().startsWith(typed.slice(index).toLowerCase())) return index;
  }
  return typed.length - typed.match(/\S*$/)[0].length;
}

function completed(field, offer) {
  if (offer.kind === 'question') return offer.value;
  const caret = field.selectionStart ?? field.value.length;
  const typed = field.value.slice(0, caret), rest = field.value.slice(caret).trimStart();
  return `${typed.slice(0, begunAt(typed, offer.value))}${offer.value} ${rest}`;
}

function takeAsked(offer, done) {
  const {field} = offered;
  const value = completed(field, offer);
  close();
  field.value = value;
  if (done && offer.kind === 'question') ask(field);
  else soon('ask-typed:', field, 0);
}

function ask(field) {
  clearTimeout(timer);
  close();
  send(`ask:${field.value.trim()}`);
  field.blur();
}

fields.ask = {
  input: (_, field) => soon('ask-typed:', field),
  keydown(event, field) {
    if (listKey(event, field)) return;
    if (event.key === 'Enter') {
      event.preventDefault();
      ask(field);
    } else if (event.key === 'ArrowDown') {
      event.preventDefault();
      soon('ask-typed:', field, 0);
    } else if (event.key === 'Escape') leave(event, field, field.dataset.asked);
  },
  blur() {
    clearTimeout(timer);
    close();
  },
};

calls.asking = ({typed, offers}) => {
  const field = fieldOf('ask');
  if (!field || field !== document.activeElement || field.value !== typed) return;
  const shown = offers.map(({text, kind, detail}) => ({
    value: text, kind, parts: [['b', '', text], ['span', 'kind', detail || kind]],
  }));
  open(field, shown, '', takeAsked);
};

/* The class of the selected object. */

fields.class = {
  input: (_, field) => soon('class-typed:', field),
  keydown(event, field) {
    if (listKey(event, field)) return;
    if (event.key === 'Enter') {
      send(`class:${field.value}`);
      leave(event, field);
    } else if (event.key === 'Escape') leave(event, field, field.defaultValue);
  },
  blur: fields.ask.blur,
};

calls.offer = ({typed, note, offers}) => {
  const field = fieldOf('class');
  // What Enter has left is asked about.
  if (note) field?.focus();
  if (!field || field !== document.activeElement || (typed !== undefined && typed !== field.value)) return;
  const shown = offers.map(({name, via, known, count}) => ({
    value: name, parts: [['b', '', name], ['span', '', via], ['span', 'kind', known ? String(count || '') : 'new']],
  }));
  open(field, shown, note, (offer, done) => {
    close();
    field.value = offer.value;
    if (done) {
      send(`class:${offer.value}`);
      field.blur();
    } else soon('class-typed:', field);
  });
};

calls.focusClass = () => {
  if (!fieldOf('class')?.checkVisibility()) calls.tab?.('Edit');
  setTimeout(() => focus(fieldOf('class')), 60);
};

/* The search. Its words stand below it, drawn by the server: buttons with data-local="take:<word>". */

const words = () => [...document.querySelectorAll('.cmp [data-local^="take:"]')];
const marked = all => all.findIndex(one => one.getAttribute('aria-selected') === 'true');
const mark = (all, to) => all.forEach((one, i) => one.setAttribute('aria-selected', String(i === to)));
const stepped = (event, all) => {
  const step = {ArrowDown: 1, ArrowUp: all.length - 1}[event.key];
  if (!step || !all.length) return -1;
  event.preventDefault();
  const to = (Math.max(marked(all), 0) + step) % all.length;
  mark(all, to);
  return to;
};

/* Where the word begins that is being typed, with what stands in quotes as one. */
export function wordBegun(text) {
  const last = [...text.matchAll(/(?:[^\s"]|"(?:[^"\\]|\\.)*(?:"|$))+/g)].pop();
  return last && last.index + last[0].length === text.length ? last.index : text.length;
}

function noWords() {
  clearTimeout(timer);
  if (words().length) send('complete:');
  words().forEach(word => word.remove());
}

locals.take = (_, word) => {
  const field = fieldOf('find');
  const goesOn = /[:<]$/.test(word);
  field.value = field.value.slice(0, wordBegun(field.value)) + word + (goesOn ? '' : ' ');
  field.focus();
  if (goesOn) soon('complete:', field, COMPLETE_MS);
  else noWords();
};

/* The search keeps the focus while one of its words is pressed. */
document.addEventListener('mousedown', event => {
  if (event.target instanceof Element && event.target.closest('.cmp')) event.preventDefault();
});

fields.find = {
  input(_, field) {
    if (field.value && !/\s$/.test(field.value)) soon('complete:', field, COMPLETE_MS);
    else noWords();
  },
  keydown(event, field) {
    const all = words();
    if (event.key === 'Enter') {
      noWords();
      send(`find:${field.value}`);
      leave(event, field);
    } else if (event.key === 'Escape') {
      noWords();
      leave(event, field);
    } else if (event.key === 'Tab' && all.length && !event.shiftKey) {
      event.preventDefault();
      locals.take(field, all[Math.max(marked(all), 0)].dataset.local.slice('take:'.length));
    } else stepped(event, all);
  },
  blur: () => clearTimeout(timer),
};

calls.find = query => {
  clearTimeout(timer);
  const field = fieldOf('find');
  if (field && field.value !== query) field.value = query;
};

/* The commands of the dialog that finds one. */

const commandRows = field => [...field.closest('dialog').querySelectorAll('.commands button')];
const visible = rows => rows.filter(row => !row.hidden);

fields.commands = {
  input(_, field) {
    const typed = field.value.toLowerCase().split(/\s+/), rows = commandRows(field);
    for (const row of rows) row.hidden = !typed.every(word => row.textContent.toLowerCase().includes(word));
    mark(rows, rows.indexOf(visible(rows)[0]));
  },
  keydown(event, field) {
    const rows = visible(commandRows(field));
    if (event.key === 'Enter' && rows.length) {
      event.preventDefault();
      rows[Math.max(marked(rows), 0)].click();
    } else rows[stepped(event, rows)]?.scrollIntoView({block: 'nearest'});
  },
};

/* Dialogs: their text is copied or sent, and their choices are sent. */

const TEXT = 'textarea, input:not([type=radio], [type=checkbox], [type=range])';

function textOf(element) {
  for (let around = element; around; around = around.parentElement) {
    const field = around.querySelector(TEXT);
    if (field) return field;
  }
  return null;
}

locals.send = (element, command) => {
  const field = textOf(element);
  if (field?.value.trim()) send(command + field.value);
};

locals.checked = (element, command) => {
  const chosen = [...element.closest('dialog').querySelectorAll('input:checked')].map(input => input.value);
  send(command + chosen.filter(Boolean).join(','));
};

/* What changes many times a second: numbers of a box that is dragged, the drawing over the picture. */

calls.overlay = marks => {
  for (const drawing of document.querySelectorAll('.pic > #overlay')) fill(drawing, marks);
};

calls.sentence = () => {
  setTimeout(() => focus(document.querySelector('input.sent')), 60);
};
