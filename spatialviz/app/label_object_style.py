"""CSS of the Edit tab while labels are shown, what its class field does in the browser, and the live overlay."""

OBJECT_CSS = """<style>
.sv .mode{margin:.6em 0 .45em;padding:2px 8px;border-left:3px solid var(--c,var(--mantine-color-dimmed));border-radius:0 4px 4px 0;background:color-mix(in srgb,var(--c,var(--mantine-color-dimmed)) 13%,transparent);font-size:11.5px;display:flex;gap:8px;align-items:center;justify-content:space-between}
.sv .mode b{font-weight:650}
.sv .said2{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .cls{position:relative;flex:1;min-width:0}
.sv .cls .find{padding:2px 7px}
.sv .cls .offers{position:absolute;left:0;right:0;top:100%;z-index:5;margin-top:2px;border-radius:5px;overflow:hidden;background:var(--mantine-color-body);box-shadow:0 3px 12px rgba(0,0,0,.35);border:1px solid var(--mantine-color-default-border)}
.sv .cls .offers:empty{display:none}
.sv .cls .offers span{display:flex;gap:8px;align-items:baseline;padding:2px 8px;cursor:pointer}
.sv .cls .offers span:hover,.sv .cls .offers .on{background:color-mix(in srgb,var(--mantine-primary-color-filled) 30%,transparent)}
.sv .cls .offers i{font-style:normal;color:var(--mantine-color-dimmed);font-size:11px}
.sv .cls .offers i.n{margin-left:auto}
.sv .cls .offers p{margin:0;padding:3px 8px;font-size:11.5px;border-left:3px solid #e0982e;background:color-mix(in srgb,#e0982e 12%,transparent)}
.sv .seg .go{background:var(--c);color:#fff}
.sv .from{display:grid;grid-template-columns:52px minmax(0,1fr) auto 20px;gap:8px;align-items:baseline;padding:1px 0}
.sv .from>span:first-child{color:var(--mantine-color-dimmed)}
.sv .from .v{overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .from .m{font-size:11px;white-space:nowrap;color:var(--mantine-color-dimmed)}
.sv .from .m:before{content:"";display:inline-block;width:7px;height:7px;border-radius:50%;margin-right:5px;box-shadow:inset 0 0 0 1.5px var(--c);background:var(--f,transparent)}
.sv .from .x{cursor:pointer;text-align:center;color:var(--mantine-color-dimmed);border-radius:4px;line-height:16px}
.sv .from .x:hover{background:var(--mantine-color-default-hover);color:var(--mantine-color-text)}
.sv .gone{display:flex;gap:8px;align-items:center;justify-content:space-between;padding:1px 0 2px 7px;border-left:3px solid #8a919c;margin-bottom:3px}
.sv .gone>span:first-child{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .tight .field{flex-direction:row;align-items:center;gap:5px;padding:0}
.sv .tight .field i{flex:none;width:8px;text-align:center}
.sv .tight .row{margin-bottom:4px}
.sv .beside{grid-column:span 2;align-content:end;gap:3px 4px;font-size:11.5px}
.sv .beside .try{padding:0 7px}
</style>"""

OBJECT_SCRIPT = r"""
(() => {
if (window.svOffer) return;
const field = () => document.querySelector('.cls input');
const list = () => document.querySelector('.cls .offers');
const rows = () => [...document.querySelectorAll('.cls .offers span')];
let timer = 0, wanted = '';
const hide = () => { clearTimeout(timer); const l = list(); if (l) l.replaceChildren(); };
const el = (tag, text, cls) => { const e = document.createElement(tag); e.textContent = text; if (cls) e.className = cls; return e; };
window.svOverlay = marks => { for (const s of document.querySelectorAll('.sv .pic > svg')) s.innerHTML = marks; };
window.svNumbers = said => {
  for (const [kind, number] of Object.entries(said)) {
    const f = document.querySelector('.field input[data-of="' + kind + '"]');
    if (f && f !== document.activeElement) f.value = number;
  }
};
window.svOffer = data => {
  const l = list(), f = field();
  if (!l || !f || document.activeElement !== f || (data.typed !== undefined && data.typed !== f.value)) return;
  l.replaceChildren();
  if (data.note) l.appendChild(el('p', data.note));
  for (const o of data.offers) {
    const row = el('span', '');
    row.dataset.w = o.name;
    row.appendChild(el('b', o.name));
    if (o.via) row.appendChild(el('i', o.via));
    row.appendChild(el('i', o.known ? (o.count || '') : 'new', 'n'));
    row.onmousedown = e => { e.preventDefault(); hide(); f.value = o.name; window.sv('class:' + o.name); };
    l.appendChild(row);
  }
};
window.svClassTyped = f => { clearTimeout(timer); timer = setTimeout(() => window.sv('class-typed:' + f.value), 60); };
window.svClassLeft = () => setTimeout(hide, 150);
window.svFocusClass = () => { window.svTab('Edit'); setTimeout(() => { const f = field(); if (f) { f.focus(); f.select(); } }, 160); };
window.svClassKey = (e, f) => {
  const all = rows(), at = all.findIndex(o => o.classList.contains('on'));
  if (e.key === 'Enter') { const v = at >= 0 ? all[at].dataset.w : f.value; f.value = v; clearTimeout(timer); window.sv('class:' + v); }
  else if (e.key === 'Escape') { e.stopPropagation(); hide(); f.value = f.defaultValue; f.blur(); }
  else if (e.key === 'Tab' && all.length && !e.shiftKey) { e.preventDefault(); f.value = all[Math.max(at, 0)].dataset.w; window.svClassTyped(f); }
  else if ((e.key === 'ArrowDown' || e.key === 'ArrowUp') && all.length) {
    e.preventDefault();
    if (at >= 0) all[at].classList.remove('on');
    const step = e.key === 'ArrowDown' ? 1 : all.length - 1;
    all[at < 0 ? (step === 1 ? 0 : all.length - 1) : (at + step) % all.length].classList.add('on');
  }
};
})();
"""
