// Three hints on the demo, one after the other: each is gone for good once it is followed or closed.

import {byId, calls, locals, sent} from './core.mjs';

const HINTS = [
  ['mend', 'Try it answers again with this one change.', '#answer .fix .go', /^(try-mend|key:Shift\+T)/],
  ['failure', 'Press . for the next wrong answer of this run.', '[data-do="next-failure:1"]', /^(next-failure|key:[.,])/],
  ['ask', 'Ask a question of your own: press / and type.', '#ask-text', /^ask:/],
];
const gone = (name, now) => {
  try { if (now) localStorage.setItem(`hint-${name}`, 'gone'); return now || localStorage.getItem(`hint-${name}`); } catch { return now; }
};

let wanted = false, shown = null;
const show = () => {
  const explains = wanted && document.body.dataset.mode === 'explain';
  shown = explains ? HINTS.find(([name, , target]) => !gone(name) && document.querySelector(target)) : null;
  byId('hint').hidden = !shown;
  for (const e of document.querySelectorAll('.hinted')) e.classList.remove('hinted');
  if (!shown) return;
  byId('hint').firstElementChild.textContent = shown[1];
  document.querySelector(shown[2]).classList.add('hinted');
};
calls.hints = on => { wanted = on; show(); };
new MutationObserver(show).observe(byId('answer'), {childList: true, subtree: true});
new MutationObserver(show).observe(document.body, {attributeFilter: ['data-mode']});
locals.hint = () => { gone(shown[0], true); show(); };
sent.push(said => {
  for (const [name, , , follows] of wanted ? HINTS : []) if (follows.test(said)) gone(name, true);
  show();
});
