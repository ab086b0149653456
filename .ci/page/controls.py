"""Controls of the page: those in view, and the stops that Tab makes at them."""

from typing import Any

from browser import Tab

# In view and reachable: visible, not inert, inside the window and not under anything that clips it.
CONTROLS = """() => {
  const all = [...document.querySelectorAll('a[href], button, input, select, textarea, summary, iframe, [tabindex]')];
  const name = e => (e.getAttribute('aria-label') || e.textContent || e.title || '').trim().slice(0, 30) || e.id;
  const shown = e => {
    if (!e.checkVisibility({visibilityProperty: true}) || e.disabled || e.closest('[inert], .hidden')) return false;
    const b = e.getBoundingClientRect();
    if (e.matches('.skip')) return false;
    let [x0, y0, x1, y1] = [b.left, b.top, b.right, b.bottom];
    for (let up = e.parentElement; up; up = up.parentElement) {
      if (getComputedStyle(up).overflow === 'visible') continue;
      const u = up.getBoundingClientRect();
      [x0, y0, x1, y1] = [Math.max(x0, u.left), Math.max(y0, u.top), Math.min(x1, u.right), Math.min(y1, u.bottom)];
    }
    return Math.min(x1, innerWidth) - Math.max(x0, 0) > 2 && Math.min(y1, innerHeight) - Math.max(y0, 0) > 2;
  };
  const groups = '[role=radiogroup], [role=tablist], [role=toolbar]', member = `:is(${groups}) button`;
  return all.filter(e => shown(e) && (e.tabIndex >= 0 || e.matches(member)))
    .map(e => ({name: `${e.tagName.toLowerCase()} ${name(e)}`, stop: e.tabIndex >= 0,
      control: !e.matches('abbr, iframe'), group: e.closest(groups)?.ariaLabel ?? ''}));
}"""


def controls(tab: Tab) -> list[dict[str, Any]]:
    """What keys reach in view: its name, whether Tab stops there, the group that arrows walk.

    Words that explain themselves and the scene are no controls.
    """
    return tab.page.evaluate(CONTROLS)
