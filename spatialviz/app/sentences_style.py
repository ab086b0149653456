"""CSS of expressions, their history and conflicts, and what their fields do in the browser."""

SENTENCES_CSS = """<style>
.sv .sent{width:100%;font:600 13px/1.35 inherit;color:inherit;background:var(--mantine-color-default-hover);border:1px solid transparent;border-radius:5px;padding:4px 7px;outline:none;margin-top:.5em}
.sv .sent:hover{border-color:var(--mantine-color-default-border)}
.sv .sent:focus{border-color:var(--mantine-primary-color-filled);background:transparent}
.sv .means{display:flex;gap:8px;justify-content:space-between;padding:3px 0 5px;font-size:11.5px}
.sv .means>span{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .means>span:last-child{flex:none;max-width:45%}
.sv .obs{display:flex;flex-wrap:wrap;gap:4px;align-items:center}
.sv .ob{display:inline-flex;align-items:center;max-width:100%;border-radius:4px;border:1px solid var(--c);background:color-mix(in srgb,var(--c) 22%,transparent);font-size:11.5px;line-height:17px;cursor:pointer;overflow:hidden}
.sv .ob.maybe{background:none;border-style:dashed}
.sv .ob.gone{text-decoration:line-through;cursor:default}
.sv .ob.at{box-shadow:0 0 0 1.5px var(--mantine-color-text)}
.sv .ob>span{padding:0 6px;min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .ob>i{font-style:normal;padding:0 5px 0 1px;color:var(--mantine-color-dimmed)}
.sv .ob>i:hover{color:var(--mantine-color-text)}
.sv .sets{display:grid;grid-template-columns:58px 1fr;gap:4px 8px;align-items:center;padding-top:2px}
.sv .sets>label{color:var(--mantine-color-dimmed)}
.sv .acts{display:flex;flex-wrap:wrap;gap:4px;font-size:11.5px}
.sv .acts span{border:1px solid var(--mantine-color-default-border);border-radius:4px;padding:0 7px;line-height:19px;cursor:pointer;white-space:nowrap;color:var(--mantine-color-dimmed)}
.sv .acts.all{grid-column:1/-1;flex-wrap:nowrap;padding-top:1px}
.sv .acts.all span{flex:1 1 auto;text-align:center;padding:0 3px}
.sv .acts span:hover{color:var(--mantine-color-text);background:var(--mantine-color-default-hover)}
.sv .acts .on{color:var(--mantine-color-text);border-color:var(--c,var(--mantine-primary-color-filled));background:color-mix(in srgb,var(--c,var(--mantine-primary-color-filled)) 22%,transparent)}
.sv .ex{border-radius:4px;padding:3px 6px;margin:0 -6px;cursor:pointer}
.sv .ex:hover{background:var(--mantine-color-default-hover)}
.sv .ex.sel{background:color-mix(in srgb,var(--mantine-primary-color-filled) 20%,transparent);box-shadow:inset 3px 0 0 var(--mantine-primary-color-filled)}
.sv .ex>div{display:flex;gap:6px;align-items:baseline;justify-content:space-between}
.sv .ex .say{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .ex.out .say{text-decoration:line-through;color:var(--mantine-color-dimmed)}
.sv .ex .tags{flex:none;font-size:11px;color:var(--mantine-color-dimmed)}
.sv .ex .tags b{font-weight:600;color:var(--c)}
.sv .ex .obs{justify-content:flex-start;padding-top:1px;flex-wrap:nowrap;overflow:hidden}
.sv .ex .ob{flex:none;font-size:11px;line-height:15px;opacity:.9}
.sv .ev{display:grid;grid-template-columns:1fr auto;gap:0 8px;padding:2px 0;border-top:1px solid color-mix(in srgb,var(--mantine-color-default-border) 55%,transparent);font-size:11.5px}
.sv .ev:first-of-type{border:0}
.sv .ev>div{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .ev .gone{text-decoration:line-through;color:var(--mantine-color-dimmed)}
.sv .ev .do{grid-row:1/3;grid-column:2;align-self:center}
.sv .ev .try{font-size:11px;padding:0 7px}
.sv .dispute{border-left:3px solid #e0982e;padding:2px 0 4px 10px;margin-top:10px}
.sv .dispute .what{font-weight:650}
.sv .two{display:grid;grid-template-columns:max-content 1fr;gap:1px 12px;padding:5px 0;overflow-wrap:anywhere}
.sv .two span{color:var(--mantine-color-dimmed)}
.sv .two b{font-weight:600}
.sv .dispute .seg{max-width:260px}
.sv .seg.pick span{cursor:pointer}
.sv .mend{margin-left:auto;flex:none}
.sv .under{display:flex;gap:8px;align-items:center;justify-content:space-between}
.sv .under>span:first-child{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
</style>"""

SENTENCES_SCRIPT = r"""
(() => {
if (window.svSentence) return;
const field = () => document.querySelector('input.sent');
window.svSentence = () => { window.svTab('Answer'); setTimeout(() => { const f = field(); if (f) { f.focus(); f.select(); } }, 60); };
window.svShown = () => setTimeout(() => { const e = document.querySelector('.ex.sel'); if (e) e.scrollIntoView({block: 'nearest'}); }, 60);
window.svReword = (e, f) => {
  e.stopPropagation();
  if (e.key === 'Enter') { window.sv('expression-text:' + f.value); f.blur(); }
  else if (e.key === 'Escape') { f.value = f.dataset.was; f.blur(); }
};
window.svDecide = () => window.sv('decide:' + [...document.querySelectorAll('.pick')].filter(p => p.querySelector('.on').dataset.mine).map(p => p.dataset.k).join(','));
window.addEventListener('keydown', e => {
  const box = document.querySelector('[role=dialog] .conflict');
  if (!box || box.querySelector('.pick') || e.ctrlKey || e.metaKey || e.altKey) return;
  const k = e.key.toLowerCase();
  if (k !== 'm' && k !== 't') return;
  e.preventDefault(); e.stopImmediatePropagation();
  window.sv(k === 'm' ? 'decide:0' : 'decide:');
}, true);
})();
"""
