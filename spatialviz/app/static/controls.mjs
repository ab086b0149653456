/* Controls that are made in the browser and not by the server. */

import {el} from './core.mjs';

/* A name with the letter underlined that is its key. */
export function hotName(button, name, key) {
  const at = name.toLowerCase().indexOf(key);
  if (at < 0) button.textContent = name;
  else button.append(name.slice(0, at), el('u', '', name[at]), name.slice(at + 1));
  return button;
}

export function button(className, text, title, press) {
  const made = el('button', className, text);
  made.type = 'button';
  made.title = title;
  made.addEventListener('click', press);
  // Keys go on to mean what they meant before.
  made.addEventListener('mousedown', event => event.preventDefault());
  return made;
}

/* Buttons of which one is pressed: [key, name, title] each. */
export function choice(className, label, options, press, hot = {}) {
  const group = el('div', `seg ${className}`);
  group.setAttribute('role', 'group');
  group.setAttribute('aria-label', label);
  for (const [key, name, title] of options) {
    const one = button('', '', title, () => press(key));
    hotName(one, name, hot[key] ?? '\n');
    one.dataset.k = key;
    group.append(one);
  }
  return group;
}

/* A slider with its name and what it says: `follow(value)` while it moves. */
export function range(className, name, low, high, follow) {
  const label = el('label', className), field = el('input');
  Object.assign(field, {type: 'range', min: low, max: high, step: 'any'});
  field.addEventListener('input', () => follow(+field.value));
  field.addEventListener('change', () => field.blur());
  label.append(el('span', '', name), field, el('output'));
  return label;
}
