/* What a script can see of how the page looks: text that is cut, and things that lie on each other. */
async () => {
// Text is cut where it is wider than its element; with an ellipsis that is meant, if a title says the whole of it. What is
// there for screen readers alone is not looked at.
const cut = () => {
  const found = [], told = e => e.closest('[title], summary, :is(button, [role=button], [role=option])[aria-label]');
  const name = e => `${e.tagName.toLowerCase()}${e.id ? '#' + e.id : ''}.${e.className} "${e.textContent.trim().slice(0, 40)}"`;
  for (const e of document.querySelectorAll('body *')) {
    if (!e.checkVisibility({visibilityProperty: true}) || e.closest('.hidden, .unseen, svg, #suggested, dialog:not([open])')) continue;
    const own = [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()), s = getComputedStyle(e);
    const field = e.matches('input[type=text], input:not([type]), select');
    if (!own && !field && !e.matches('button')) continue;
    const clips = s.overflowX !== 'visible' || field;
    if (clips && !['auto', 'scroll'].includes(s.overflowX) && e.scrollWidth > e.clientWidth + 1
        && !(s.textOverflow === 'ellipsis' && (told(e) || field))) found.push('cut: ' + name(e));
    if (!clips && s.display !== 'inline' && e.scrollWidth > e.clientWidth + 2 && e.clientWidth) found.push('spills: ' + name(e));
    // What leaves the box of one that clips it and does not scroll is cut too.
    if (!own || clips) continue;
    const range = document.createRange();
    range.selectNodeContents(e);
    const b = range.getBoundingClientRect();
    for (let up = e.parentElement; up && up !== document.body; up = up.parentElement) {
      const us = getComputedStyle(up);
      if (us.overflowX === 'visible') continue;
      const u = up.getBoundingClientRect();
      const scrolls = ['auto', 'scroll'].includes(us.overflowX) && up.scrollWidth > up.clientWidth + 1;
      if ((us.textOverflow !== 'ellipsis' || e.matches('button')) && !scrolls && (b.right > u.right + 1.5 || b.left < u.left - 1.5)) {
        found.push(`leaves ${name(up).slice(0, 40)}: ${name(e)}`);
      }
      break;
    }
  }
  for (const scroller of document.querySelectorAll('#bar, #side, #stage, #scene-tools, #drawer-tabs, #drawer-body > *, #picture')) {
    if (scroller.checkVisibility() && !scroller.querySelector('.menu[open]') && scroller.scrollWidth > scroller.clientWidth + 1) found.push(`scrolls sideways: ${name(scroller).slice(0, 60)}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push('the page scrolls sideways');
  return [...new Set(found)];
};
const common = (a, b) => Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0])) * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
// Controls must not lie on each other.
const overlap = () => {
  const found = [], name = e => `${e.tagName.toLowerCase()}${e.id ? '#' + e.id : ''} "${(e.getAttribute('aria-label') || e.textContent).trim().slice(0, 30)}"`;
  const clipped = e => {
    let b = e.getBoundingClientRect(), box = [b.left, b.top, b.right, b.bottom];
    for (let up = e.parentElement; up; up = up.parentElement) {
      if (getComputedStyle(up).overflow === 'visible') continue;
      const u = up.getBoundingClientRect();
      box = [Math.max(box[0], u.left), Math.max(box[1], u.top), Math.min(box[2], u.right), Math.min(box[3], u.bottom)];
    }
    return box;
  };
  // What lies over the rest on a ground of its own: the drawer, a hint, the bar of a decision.
  const over = e => e.closest('#drawer, #hint, .decide');
  const groups = [
    [...document.querySelectorAll('button, input, select, textarea, summary, [data-do]')].filter(e => !e.closest('#toasts, #tags, #ask-problem')),
  ];
  const dialog = document.querySelector('dialog[open], .menu[open]');
  for (const group of groups) {
    const shown = group.filter(e => e.checkVisibility({visibilityProperty: true, opacityProperty: true}) && (!dialog || dialog.contains(e)) && !e.closest('[inert]')).map(e => [e, clipped(e)])
      .filter(([, b]) => b[2] - b[0] > 1 && b[3] - b[1] > 1);
    shown.forEach(([e, a], i) => {
      for (const [f, b] of shown.slice(i + 1)) {
        if (!e.contains(f) && !f.contains(e) && over(e) === over(f) && common(a, b) > 6) {
          found.push(`${name(e)} on ${name(f)}`);
        }
      }
    });
  }
  return found;
};
// A name in the scene covers neither what it names (unless that fills the scene) nor another name, legend or button.
const tagged = async () => {
  if (!document.getElementById('scene').checkVisibility()) return [];
  const tags = (await import('/app/tags.mjs')).shownTags(), {left, top, width, height} = document.getElementById('tags').getBoundingClientRect();
  const others = [...document.querySelectorAll('#scene-tools>*, #scene-low, #scene-buttons>*, #moves .moves')].map(e => [e, e.getBoundingClientRect()])
    .filter(([, b]) => b.width).map(([e, b]) => [e.id || e.className || e.tagName, [b.left - left, b.top - top, b.right - left, b.bottom - top]]);
  return tags.flatMap((tag, i) => [
    ...(common(tag.rect, tag.box) > 1 && common(tag.box, [0, 0, width, height]) < 0.5 * width * height ? [`tag ${tag.text} covers what it names`] : []),
    ...(common(tag.rect, [0, 0, width, height]) < (tag.rect[2] - tag.rect[0]) * (tag.rect[3] - tag.rect[1]) - 1 ? [`tag ${tag.text} leaves the scene`] : []),
    ...tags.slice(i + 1).filter(other => common(tag.rect, other.rect) > 1).map(other => `tag ${tag.text} on ${other.text}`),
    ...others.filter(([, box]) => common(tag.rect, box) > 1).map(([name]) => `tag ${tag.text} on ${name}`),
  ]);
};
return [...cut(), ...overlap(), ...await tagged()];
}
