"""CSS of the Run tab, the search and the dialogs, and what their fields do in the browser."""

RUN_CSS = """<style>
:has(>[data-dock-tab]:nth-child(5))>[data-dock-tab]{padding:0 8px!important;font-size:13px}
.sv .runhead{display:flex;justify-content:space-between;gap:10px;padding-top:.6em}
.sv .runhead b{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .runhead span{white-space:nowrap}
.sv .oneline{overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .small{font-size:11px;line-height:1.35;padding-top:3px}
.sv .vrow{display:grid;grid-template-columns:92px 1fr 34px 36px 56px;gap:6px;align-items:center;height:21px;border-radius:3px;cursor:pointer;padding:0 4px;margin:0 -4px}
.sv .vrow:hover{background:var(--mantine-color-default-hover)}
.sv .vrow .n{text-align:right;white-space:nowrap}
.sv .vrow .vd{overflow:hidden;text-overflow:ellipsis;text-align:left}
.sv .vrow .t{position:relative;height:9px;border-radius:2px;background:color-mix(in srgb,var(--mantine-color-dimmed) 18%,transparent)}
.sv .vrow .t i{position:absolute;inset:0 auto 0 0;background:var(--c);border-radius:2px}
.sv .vrow .t u{position:absolute;top:50%;height:1.5px;margin-top:-.75px;background:var(--mantine-color-text);opacity:.75}
.sv .vrow .t u:before,.sv .vrow .t u:after{content:"";position:absolute;top:-3px;width:1.5px;height:7px;background:inherit}
.sv .vrow .t u:before{left:0}
.sv .vrow .t u:after{right:0}
.sv table.costs td,.sv table.costs th{padding:1.5px 4px}
.sv .cost{position:relative;height:14px}
.sv .cost:after{content:"";position:absolute;left:var(--z);top:-2px;bottom:-2px;width:1px;background:var(--mantine-color-dimmed)}
.sv .cost i{position:absolute;top:0;height:6px;background:var(--c);border-radius:1px;min-width:1px}
.sv .cost i.hollow{top:8px;background:none;box-shadow:inset 0 0 0 1.4px var(--c)}
.sv .cuts .seg{font-size:11px;margin-bottom:4px}
.sv table.slices td{padding:2px 4px}
.sv table.slices td.w{width:32%}
.sv table.slices .stack{height:10px;margin:1px 0}
.sv table.slices tr.r .stack i{cursor:pointer}
.sv table.slices .stack i:hover{filter:brightness(1.25)}
.sv .cmx{overflow-x:auto;padding-bottom:2px}
.sv .cmx table{width:auto;border-collapse:separate;border-spacing:1.5px}
.sv .cmx th{border:0;padding:0;font-size:10.5px}
.sv .cmx th span{display:block;writing-mode:vertical-rl;transform:rotate(180deg);margin:0 auto;padding-top:3px;white-space:nowrap}
.sv .cmx th.a{text-align:right;padding-right:4px;color:var(--mantine-color-text);cursor:pointer;white-space:nowrap}
.sv .cmx td{padding:0;width:22px;min-width:22px;height:19px;text-align:center;font-size:10.5px;border-radius:2px}
.sv .cmx td.o{color:var(--mantine-color-dimmed);opacity:.5}
.sv .cmx td.c{cursor:pointer;background:color-mix(in srgb,var(--k) calc(100%*var(--a)),transparent)}
.sv .cmx td.c:hover{box-shadow:0 0 0 1.5px var(--mantine-color-text)}
.sv .cmx .g{--k:#3a9e68}
.sv .cmx .b{--k:#d5443c}
.sv .cmx .q{--k:#7e8896}
.sv .syntax{font-size:10.5px;line-height:1.3;padding:3px 2px 0;white-space:nowrap;overflow:hidden;text-overflow:ellipsis}
.sv .cmp{display:flex;flex-wrap:wrap;gap:3px;padding-top:4px}
.sv .cmp span{max-width:100%;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;border:1px solid var(--mantine-color-default-border);border-radius:4px;padding:0 6px;font-size:11.5px;cursor:pointer}
.sv .cmp span:hover,.sv .cmp .on{background:color-mix(in srgb,var(--mantine-primary-color-filled) 30%,transparent);border-color:var(--mantine-primary-color-filled)}
.sv textarea.state{width:100%;resize:vertical;font:12px/1.35 ui-monospace,monospace;color:inherit;background:var(--mantine-color-default-hover);border:1px solid var(--mantine-color-default-border);border-radius:5px;padding:6px 8px;outline:none;overflow-wrap:anywhere;margin-top:4px}
.sv textarea.state:focus{border-color:var(--mantine-primary-color-filled)}
.sv .copied{font-weight:600;color:var(--mantine-color-text);min-height:1.4em}
.sv .buttons{display:flex;justify-content:flex-end;gap:6px;padding-top:8px}
.sv .try.go{color:#fff;background:var(--mantine-primary-color-filled);border-color:var(--mantine-primary-color-filled)}
.sv .try.go:hover{filter:brightness(1.12)}
.sv .field{display:flex;align-items:center;gap:4px;padding-bottom:4px}
.sv pre.file{white-space:pre-wrap;overflow-wrap:anywhere;margin:6px 0;padding:6px 8px;border-radius:5px;background:var(--mantine-color-default-hover)}
.sv .keep{display:flex;gap:4px;padding-top:2px}
.sv .keep .try{flex:1 1 auto;text-align:center;padding:1px 4px;font-size:11.5px}
</style>"""

FIELD_SCRIPT = r"""
(() => {
if (window.svFind) return;
const field = () => document.querySelector('input.find.runs');
const offers = () => [...document.querySelectorAll('.cmp span')];
let timer = 0;
const begun = v => { const all = [...v.matchAll(/(?:[^\s"]|"(?:[^"\\]|\\.)*(?:"|$))+/g)], m = all.pop(); return m && m.index + m[0].length === v.length ? m.index : v.length; };
const ask = v => { clearTimeout(timer); timer = setTimeout(() => window.sv('complete:' + v), 90); };
const hide = () => { clearTimeout(timer); if (offers().length) window.sv('complete:'); for (const o of offers()) o.remove(); };
window.svFind = v => { clearTimeout(timer); const f = field(); if (f && f.value !== v) f.value = v; };
window.svTake = w => { const f = field(), open = w.endsWith(':') || w.endsWith('<'); f.value = f.value.slice(0, begun(f.value)) + w + (open ? '' : ' '); f.focus(); if (open) ask(f.value); else hide(); };
window.svTyped = f => { if (f.value && !/\s$/.test(f.value)) ask(f.value); else hide(); };
window.svKey = (e, f) => {
  const all = offers(), at = all.findIndex(o => o.classList.contains('on'));
  if (e.key === 'Enter') { hide(); window.sv('find:' + f.value); f.blur(); }
  else if (e.key === 'Escape') { e.stopPropagation(); hide(); f.blur(); }
  else if (e.key === 'Tab' && all.length && !e.shiftKey) { e.preventDefault(); window.svTake(all[Math.max(at, 0)].dataset.w); }
  else if ((e.key === 'ArrowDown' || e.key === 'ArrowUp') && all.length) {
    e.preventDefault();
    if (at >= 0) all[at].classList.remove('on');
    all[(Math.max(at, 0) + (e.key === 'ArrowDown' ? 1 : all.length - 1)) % all.length].classList.add('on');
  }
};
const near = e => e.closest('[role=dialog]') || document;
const text = e => near(e).querySelector('textarea, input');
window.svSend = (e, kind) => { const t = text(e); if (t && t.value.trim()) window.sv(kind + t.value); };
window.svFocus = e => setTimeout(() => { const t = text(e); if (t) { t.focus(); t.select(); } }, 120);
window.svCopy = e => {
  const t = text(e), box = near(e).querySelector('.copied');
  const byHand = () => { t.focus(); t.select(); box.textContent = document.execCommand('copy') ? 'Copied to the clipboard.' : 'The browser does not allow it: copy it by hand (Ctrl+C).'; };
  if (navigator.clipboard && window.isSecureContext) navigator.clipboard.writeText(t.value).then(() => { t.select(); box.textContent = 'Copied to the clipboard.'; }, byHand);
  else byHand();
};
window.addEventListener('keydown', e => { if (e.key === 'Escape' && document.querySelector('[role=dialog]')) window.sv('close-dialog'); });
})();
"""
