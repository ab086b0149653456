/* Every pair of size and weight of type that is in view, with what has it; what is drawn as SVG has units of its own. */
() => {
const found = new Map(), apart = 'svg, .hidden, .unseen, option, [type=range], [type=checkbox], [type=radio]';
for (const e of document.querySelectorAll('body, body *')) {
  if (e.closest(apart) || !e.checkVisibility({visibilityProperty: true})) continue;
  if (!e.matches('input, textarea') && ![...e.childNodes].some(n => n.nodeType === 3 && n.data.trim())) continue;
  const s = getComputedStyle(e), kind = `${parseFloat(s.fontSize)} ${s.fontWeight}`;
  const up = e.closest('[id]'), name = `#${up?.id ?? ''} ${e.tagName.toLowerCase()}.${e.className} "${e.textContent.trim().slice(0, 24)}"`;
  found.set(kind, [...(found.get(kind) ?? []), name]);
}
return [...found].map(([kind, names]) => [kind, [...new Set(names)]]);
}
