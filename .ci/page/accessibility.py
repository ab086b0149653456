"""axe-core in a tab (WCAG 2.2 AA), and sizes of what is pressed."""

from importlib import resources
from typing import Any

from browser import Tab

AXE = """async rules => {
  const options = {iframes: false, resultTypes: ['violations'],
    ...(rules.length ? {runOnly: rules} : {rules: {'target-size': {enabled: true}}})};
  return (await axe.run({exclude: [['#view']]}, options)).violations;
}"""
# WCAG 2.5.8, also of what is pressed and takes no focus, which axe-core leaves out: a target that is smaller than 24x24
# keeps a circle of 24 to itself.
# Of a bar of shares the width is the figure itself, and its searches stand beside it as chips.
SMALL = """() => {
  const pressed = 'a[href], button, input, select, textarea, summary, [data-do], [data-local]';
  const all = [...document.querySelectorAll(pressed)]
    .filter(e => e.checkVisibility({visibilityProperty: true}) && !e.closest('[inert], .hidden, .stack'))
    .map(e => [e, e.getBoundingClientRect()]).filter(([, b]) => b.width && b.height);
  const small = b => Math.min(b.width, b.height) < 23.5;
  const near = (x, y, b) => small(b) ? Math.hypot(x - b.left - b.width / 2, y - b.top - b.height / 2) < 24
    : Math.hypot(Math.max(b.left - x, 0, x - b.right), Math.max(b.top - y, 0, y - b.bottom)) < 12;
  return all.filter(([, b]) => small(b)).flatMap(([e, b]) => {
    const x = b.left + b.width / 2, y = b.top + b.height / 2;
    const other = all.find(([f, c]) => !e.contains(f) && !f.contains(e) && near(x, y, c));
    const name = f => f.getAttribute('aria-label') || f.textContent.slice(0, 30) || f.id;
    const size = `${b.width | 0}x${b.height | 0} ${e.tagName}`;
    return other ? [`target-size: ${size} "${name(e)}" beside "${name(other[0])}"`] : [];
  });
}"""
SOURCE = (resources.files("axe_playwright_python") / "axe.min.js").read_text("utf-8")


def axe(tab: Tab, *rules: str) -> list[str]:
    """What axe-core finds, by all or some of its rules; the document of the scene's frame is viser's."""
    if not tab.page.evaluate("typeof axe === 'object'"):
        tab.page.evaluate(f"() => {{ {SOURCE} }}")
    found: Any = tab.page.evaluate(AXE, list(rules))
    return [f"{v['id']}: {v['help']}: {node['html'][:160]}" for v in found for node in v["nodes"][:4]]
