// What is said of a thing while the mouse rests on it (its title) is also shown while it has the focus of the keyboard.

import {byId, el} from './core.mjs';

const tip = el('div');
tip.id = 'tip';
tip.popover = 'manual';
// A title is read to those who hear the page.
tip.setAttribute('aria-hidden', 'true');

const hide = () => { if (tip.matches(':popover-open')) tip.hidePopover(); };
const show = e => {
  tip.textContent = e.title;
  // The top layer of a dialog is the dialog's.
  (e.closest('dialog') ?? document.body).append(tip);
  tip.showPopover();
  const at = e.getBoundingClientRect(), {width, height} = tip.getBoundingClientRect();
  const below = at.bottom + 6 + height < innerHeight;
  tip.style.left = `${Math.max(8, Math.min(at.left, innerWidth - width - 8))}px`;
  tip.style.top = `${below ? at.bottom + 6 : Math.max(8, at.top - 6 - height)}px`;
};
document.addEventListener('focusin', e => {
  hide();
  // A finger has no hover: a word of the glossary tells itself when it is touched.
  const told = e.target.title && (e.target.matches(':focus-visible') || e.target.tagName === 'ABBR');
  if (told && !byId('suggested')?.matches(':popover-open')) show(e.target);
});
for (const kind of ['focusout', 'pointerdown', 'wheel']) document.addEventListener(kind, hide, {passive: true});
window.addEventListener('keydown', e => { if (e.key === 'Escape') hide(); }, true);
