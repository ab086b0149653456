"""The page's own CSS and JavaScript, on top of viser's (Mantine's) variables, so that both themes follow."""

CSS = """<style>
.sv{font-size:12.5px;line-height:1.4;padding:0 .8em .5em;color:var(--mantine-color-text);font-variant-numeric:tabular-nums}
.sv *{box-sizing:border-box}
.sv ::-webkit-scrollbar{width:8px;height:8px}
.sv ::-webkit-scrollbar-thumb{background:color-mix(in srgb,var(--mantine-color-dimmed) 45%,transparent);border-radius:4px}
.sv .dim{color:var(--mantine-color-dimmed)}
.sv .h{display:flex;justify-content:space-between;align-items:baseline;font-size:10.5px;letter-spacing:.07em;text-transform:uppercase;color:var(--mantine-color-dimmed);margin:.55em 0 .3em;font-weight:600}
.sv .h{gap:10px}
.sv .h>span{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;letter-spacing:0;text-transform:none;font-weight:400}
.sv .h>b{letter-spacing:0;text-transform:none;font-size:12.5px;color:var(--mantine-color-text)}
.sv .dot{display:inline-block;width:8px;height:8px;border-radius:2px;background:var(--c);margin-right:6px;flex:none}
.sv .ring{display:inline-block;width:8px;height:8px;border-radius:2px;box-shadow:inset 0 0 0 1.5px var(--c);margin-right:6px;flex:none}
.sv .chips{display:flex;flex-wrap:wrap;gap:4px;align-items:center}
.sv .nav{display:flex;justify-content:space-between;align-items:center;font-size:11.5px}
.sv .moves{display:grid;grid-template-columns:repeat(3,1fr);gap:4px;margin-top:6px;font-size:11.5px}
.sv .moves span{border:1px solid var(--mantine-color-default-border);border-radius:5px;padding:1px 4px;text-align:center;white-space:nowrap;color:var(--mantine-color-dimmed);opacity:.55;cursor:default;user-select:none}
.sv .moves i{font-style:normal;margin-right:5px}
.sv .moves .on{color:var(--mantine-color-text);opacity:1;cursor:pointer}
.sv .moves .on:hover{background:var(--mantine-color-default-hover);border-color:var(--mantine-color-dimmed)}
.sv .chip{max-width:100%;overflow:hidden;text-overflow:ellipsis;border-radius:4px;padding:1px 7px;border:1px solid var(--c);color:var(--c);font-weight:600;white-space:nowrap}
.sv .chip.rel{border:1px dashed var(--mantine-color-dimmed);color:var(--mantine-color-text);font-weight:500}
.sv .try{border-radius:10px;padding:1px 9px;border:1px solid var(--mantine-color-default-border);color:var(--mantine-color-dimmed);cursor:pointer;max-width:100%;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .try:hover{color:var(--mantine-color-text);background:var(--mantine-color-default-hover)}
.sv .try[aria-disabled]{opacity:.4;cursor:default;pointer-events:none}
.sv .try.on{color:var(--mantine-color-text);border-color:var(--mantine-primary-color-filled)}
.sv .note{margin-top:.35em;border-left:3px solid var(--c);padding:4px 8px;background:color-mix(in srgb,var(--c) 12%,transparent);border-radius:0 4px 4px 0;overflow-wrap:anywhere}
.sv .strip{display:grid;grid-auto-flow:column;grid-auto-columns:minmax(0,1fr);gap:3px}
.sv .mod{border-radius:4px;padding:3px 2px;text-align:center;background:color-mix(in srgb,var(--c) 13%,transparent);border-top:3px solid var(--c);cursor:help;overflow:hidden}
.sv .mod b{display:block;font-size:11px;font-weight:650}
.sv .mod i{display:block;font-style:normal;font-size:10px;color:var(--mantine-color-dimmed);white-space:nowrap}
.sv .busy{position:relative}
.sv .busy .strip{animation:svdim 0s .15s forwards}
.sv .busy>span{position:absolute;inset:0;display:flex;align-items:center;justify-content:center;gap:7px;font-weight:600;opacity:0;animation:svshow 0s .15s forwards}
.sv .busy>span:before{content:"";width:11px;height:11px;border-radius:50%;border:2px solid var(--mantine-color-dimmed);border-top-color:transparent;animation:svturn .9s linear infinite}
@keyframes svdim{to{opacity:.12;filter:grayscale(1)}}
@keyframes svshow{to{opacity:1}}
@keyframes svturn{to{transform:rotate(1turn)}}
.sv .row{display:flex;align-items:center;gap:8px;margin-bottom:5px}
.sv .row>label{width:52px;flex:none;color:var(--mantine-color-dimmed)}
.sv .seg{display:flex;flex:1;border:1px solid var(--mantine-color-default-border);border-radius:5px;overflow:hidden}
.sv .seg span{flex:1 1 auto;text-align:center;padding:2px 0;cursor:pointer;border-right:1px solid var(--mantine-color-default-border);white-space:nowrap}
.sv .seg span:last-child{border:0}
.sv .seg span:not(.on):hover{background:var(--mantine-color-default-hover)}
.sv .seg .on{background:var(--mantine-primary-color-filled);color:#fff}
.sv .tog{display:flex;flex-wrap:wrap;gap:4px;flex:1}
.sv .tog span{border:1px solid var(--mantine-color-default-border);border-radius:10px;padding:0 8px;cursor:pointer;color:var(--mantine-color-dimmed)}
.sv .tog .on{border-color:var(--mantine-primary-color-filled);color:var(--mantine-color-text);background:color-mix(in srgb,var(--mantine-primary-color-filled) 18%,transparent)}
.sv table{border-collapse:collapse;width:100%}
.sv td,.sv th{padding:3px;text-align:left;white-space:nowrap}
.sv th{font-size:10.5px;font-weight:500;color:var(--mantine-color-dimmed);border-bottom:1px solid var(--mantine-color-default-border)}
.sv td.n,.sv th.n{text-align:right}
.sv td.w{max-width:0;width:50%;overflow:hidden;text-overflow:ellipsis}
.sv tr.r{cursor:pointer}
.sv tr.r:hover td{background:var(--mantine-color-default-hover)}
.sv tr.sel td{background:color-mix(in srgb,var(--mantine-primary-color-filled) 20%,transparent)}
.sv tr.sel td:first-child{box-shadow:inset 3px 0 0 var(--mantine-primary-color-filled)}
.sv .upchip{flex:none;border-radius:4px;padding:0 6px;font-size:11px;border:1px solid color-mix(in srgb,var(--c) 55%,transparent);color:var(--mantine-color-dimmed);white-space:nowrap}
.sv .upchip[role=button]{cursor:pointer}
.sv .upchip.loud{border-color:var(--c);background:color-mix(in srgb,var(--c) 18%,transparent);color:var(--warn,#e8a33d);font-weight:650}
.sv .upchip[role=button]:hover,.sv .upchip[aria-pressed=true]{border-color:var(--mantine-primary-color-filled)}
.sv .uptold{padding:.35em 0 .1em}
.sv .uptold code{white-space:nowrap}
[data-mantine-color-scheme=light] .sv{--warn:#a85b00}
.sv .low{color:var(--warn,#e8a33d);font-weight:600}
.sv .scroll{max-height:var(--mh,260px);overflow:auto}
.sv .bar{display:grid;grid-template-columns:76px 1fr 14px 34px;align-items:center;gap:7px;height:18px;border-radius:3px;cursor:pointer;padding:0 4px;margin:0 -4px}
.sv .bar:hover{background:var(--mantine-color-default-hover)}
.sv .bar .t{height:9px;border-radius:2px;background:color-mix(in srgb,var(--mantine-color-dimmed) 25%,transparent);overflow:hidden;position:relative}
.sv .bar .t:after{content:"";position:absolute;left:50%;top:0;bottom:0;width:1px;background:var(--mantine-color-dimmed);opacity:.55}
.sv .bar .f{display:block;height:100%;background:var(--c)}
.sv .bar.on{font-weight:650}
.sv .bar .n{text-align:right}
.sv .bar .s{font-size:10px;color:var(--mantine-color-dimmed);text-align:center}
.sv .big{display:flex;align-items:center;font-size:15px;gap:6px;padding:.35em 0 .1em}
.sv .big .p{margin-left:auto;font-size:19px;font-weight:650}
.sv .heads{display:flex;gap:1.1em;align-items:baseline;padding-bottom:.15em}
.sv .heads b{font-size:19px;font-weight:650;margin-left:2px}
.sv .name{display:inline-flex;align-items:center;min-width:0;max-width:100%}
.sv .name b{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .thumb{width:34px;height:34px;object-fit:cover;border-radius:4px;display:block;background:var(--mantine-color-default-hover)}
.sv .stack{display:flex;height:9px;border-radius:2px;overflow:hidden;margin:3px 0}
.sv .stack i{background:var(--c);height:100%}
.sv .legend{display:flex;flex-wrap:wrap;gap:2px 10px;font-size:11px}
.sv .facts{display:grid;grid-template-columns:auto 1fr;gap:1px 10px}
.sv .facts span:nth-child(odd){color:var(--mantine-color-dimmed)}
.sv .pic{position:relative;width:100%;max-width:max(220px,calc((50vh - 210px)*var(--wh)));margin:0 auto;border-radius:5px;overflow:hidden;cursor:crosshair;line-height:0}
.sv .pic img{width:100%;display:block}
.sv .pic svg{position:absolute;inset:0;width:100%;height:100%;pointer-events:none}
.sv .grid{display:grid;grid-template-columns:repeat(3,1fr);gap:6px}
.sv .cell{cursor:pointer;border-radius:5px;overflow:hidden;border:2px solid transparent;background:var(--mantine-color-default-hover);font-size:10.5px}
.sv .cell img{width:100%;aspect-ratio:4/3;object-fit:cover;display:block}
.sv .cell div{padding:1px 5px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;direction:rtl;text-align:left}
.sv .cell .none{aspect-ratio:4/3;display:block;overflow-wrap:anywhere;color:var(--mantine-color-dimmed);padding:4px 6px;white-space:normal;overflow:hidden;font-size:10px;line-height:1.25}
.sv .cell:hover{border-color:var(--mantine-color-dimmed)}
.sv .cell.sel{border-color:var(--mantine-primary-color-filled)}
.sv kbd{font:inherit;font-size:10.5px;border:1px solid var(--mantine-color-default-border);border-radius:3px;padding:0 4px;background:var(--mantine-color-default-hover)}
.sv.keylists.two{display:grid;grid-template-columns:1fr 1fr;gap:28px;align-items:start}
.mantine-Modal-content:has(.keylists.two){flex:0 0 min(900px,94vw) !important}
.sv .keys{display:grid;grid-template-columns:auto 1fr;gap:1px 14px;align-items:baseline;font-size:13px}
.sv .log div{padding:2px 0;border-bottom:1px solid color-mix(in srgb,var(--mantine-color-default-border) 50%,transparent);overflow-wrap:anywhere}
.sv .lab{display:grid;grid-template-columns:84px 84px 1fr auto;align-items:center;gap:8px;padding:2px 6px;margin:0 -6px;border-radius:4px;cursor:pointer}
.sv .lab:hover{background:var(--mantine-color-default-hover)}
.sv .lab.sel{background:color-mix(in srgb,var(--mantine-primary-color-filled) 20%,transparent);box-shadow:inset 3px 0 0 var(--mantine-primary-color-filled)}
.sv .lab .n{text-align:right}
.sv .tuf{display:flex;gap:3px}
.sv .tuf span{flex:1;text-align:center;border-radius:3px;border:1px solid var(--mantine-color-default-border);line-height:17px;color:var(--mantine-color-dimmed)}
.sv .tuf span:hover{border-color:var(--c)}
.sv .tuf .on{background:var(--c);border-color:var(--c);color:#fff;font-weight:650}
.sv .vd{display:inline-block;border-radius:4px;padding:0 6px;font-size:11px;font-weight:650;line-height:17px;color:#fff;background:var(--c);white-space:nowrap}
.sv .vd i{font-style:normal;font-weight:450;opacity:.92}
.sv .vline{display:flex;align-items:center;gap:7px;min-width:0;cursor:pointer;margin:1px 0 3px;border-radius:4px}
.sv .vline:hover{background:var(--mantine-color-default-hover)}
.sv .vline>span:last-child{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;color:var(--mantine-color-dimmed)}
.sv .said{font-size:13px;line-height:1.45}
.sv .vcs{display:flex;flex-wrap:wrap;gap:3px;margin:4px 0 2px}
.sv .vc{border:1px solid color-mix(in srgb,var(--c) 60%,transparent);border-left:4px solid var(--c);border-radius:4px;padding:0 5px;font-size:10.5px;line-height:17px;cursor:pointer;white-space:nowrap}
.sv .vc:hover,.sv .vc.on{background:color-mix(in srgb,var(--c) 28%,transparent)}
.sv .find{width:100%;font:inherit;color:inherit;background:var(--mantine-color-default-hover);border:1px solid var(--mantine-color-default-border);border-radius:5px;padding:4px 8px;outline:none}
.sv .find:focus{border-color:var(--mantine-primary-color-filled)}
.sv .thumb.wide{width:46px;height:34px;display:block}
.sv table.found td{padding:3px 4px;vertical-align:middle}
.sv table.found td.w b{display:-webkit-box;-webkit-line-clamp:2;-webkit-box-orient:vertical;overflow:hidden;white-space:normal;line-height:1.25}
.sv table.oracles td{padding:2px 3px}
.sv tr.on td{background:color-mix(in srgb,var(--mantine-primary-color-filled) 14%,transparent)}
.sv tr.sum td{border-top:1px solid var(--mantine-color-default-border)}
.sv .diverge{position:relative;height:9px;background:color-mix(in srgb,var(--mantine-color-dimmed) 18%,transparent);border-radius:2px}
.sv .diverge:after{content:"";position:absolute;left:50%;top:-2px;bottom:-2px;width:1px;background:var(--mantine-color-dimmed)}
.sv .diverge i{position:absolute;top:0;bottom:0;background:var(--c);border-radius:2px}
.sv .mx{overflow:auto;max-height:46vh}
.sv .mx table{width:auto;border-spacing:2px;border-collapse:separate}
.sv .mx td,.sv .mx th{padding:1px 2px;font-size:11px}
.sv .mx th{border:0;text-align:center;color:var(--r);font-weight:600}
.sv .mx th i{display:block;font-style:normal;font-weight:400;color:var(--mantine-color-dimmed)}
.sv .mx td.c{width:30px;min-width:30px;height:22px;text-align:center;cursor:pointer;border-radius:3px;background:color-mix(in srgb,var(--t) calc(var(--a)*100%),transparent);border:2px solid transparent}
.sv .mx td.c:hover{border-color:var(--mantine-color-dimmed)}
.sv .mx td.ok{border-color:var(--g)}
.sv .mx td.sel{box-shadow:0 0 0 2px var(--mantine-color-text)}
.sv .mx td.top{font-weight:750}
.sv .mx td.no{text-align:center;color:var(--mantine-color-dimmed)}
.sv .mx td.w2{max-width:104px;overflow:hidden;text-overflow:ellipsis}
.sv .before{display:flex;align-items:center;gap:7px;margin:.5em 0 -.1em;padding:3px 8px;border-left:3px solid var(--c);border-radius:0 4px 4px 0;background:color-mix(in srgb,var(--c) 10%,transparent);font-size:12px}
.sv .before .said1{flex:1;min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .chg{font-weight:650;box-shadow:inset 0 -2px 0 var(--ed,#c9a92b)}
[data-mantine-color-scheme=dark] .sv input{color-scheme:dark}
.sv .fields{display:grid;grid-template-columns:repeat(3,1fr);gap:5px;flex:1;min-width:0}
.sv .fields.four{grid-template-columns:repeat(2,1fr)}
.sv .field{display:flex;flex-direction:column;min-width:0}
.sv .field i{font-style:normal;font-size:10px;line-height:1.2;color:var(--mantine-color-dimmed);white-space:nowrap;overflow:hidden;text-overflow:ellipsis}
.sv .field input{width:100%;min-width:0;font:inherit;font-size:12px;color:inherit;background:var(--mantine-color-default-hover);border:1px solid var(--mantine-color-default-border);border-radius:4px;padding:1px 5px;outline:none}
.sv .field input:focus{border-color:var(--mantine-primary-color-filled)}
.sv .row>.chips{flex:1;min-width:0}
.sv .slide{display:grid;grid-template-columns:minmax(52px,auto) 1fr 34px;gap:8px;align-items:center;margin-bottom:4px}
.sv .slide>span{max-width:130px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;color:var(--mantine-color-dimmed)}
.sv .slide input{-webkit-appearance:none;appearance:none;width:100%;min-width:0;height:6px;margin:0;border-radius:3px;cursor:pointer;background:linear-gradient(to right,var(--mantine-primary-color-filled) calc(var(--v)*100%),color-mix(in srgb,var(--mantine-color-dimmed) 30%,transparent) 0)}
.sv .slide input::-webkit-slider-thumb{-webkit-appearance:none;width:13px;height:13px;border-radius:50%;background:var(--mantine-primary-color-filled);border:2px solid #fff;box-shadow:0 0 2px rgba(0,0,0,.5)}
.svband{position:absolute;border:2px solid #f0d654;background:rgba(240,214,84,.22);pointer-events:none}
.sv .slide b{text-align:right;font-weight:600}
.sv .edit{display:flex;align-items:center;gap:8px;justify-content:space-between;border-left:3px solid var(--c);padding:1px 0 1px 7px;margin-bottom:3px}
.sv .edit>span:first-child{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .h .try{letter-spacing:0;text-transform:none;font-weight:400}
.svhost{position:absolute;inset:0;overflow:hidden;pointer-events:none;z-index:1}
.svtag{position:absolute;left:0;top:0;will-change:transform;background:var(--c);color:#fff;font:600 12px/1 system-ui,sans-serif;padding:4px 7px;border-radius:4px;white-space:nowrap;box-shadow:0 1px 5px rgba(0,0,0,.5);text-shadow:0 0 2px rgba(0,0,0,.45)}
.svtag{max-width:240px;overflow:hidden;text-overflow:ellipsis}
.svtag i{font-style:normal;font-weight:400;opacity:.9}
.svtag.weak{font-weight:500;font-size:11px;padding:3px 5px;opacity:.92}
</style>"""

SCRIPT = """
(() => {
window.sv = v => window.__viserMutable.sendMessage({type: 'GuiUpdateMessage', uuid: 'BUS_UUID', updates: {value: v + '#' + performance.now()}});
let live = null, waiting = 0;
window.svLive = v => { live = v; if (v === null) { clearTimeout(waiting); waiting = 0; } else if (!waiting) waiting = setTimeout(() => { waiting = 0; if (live !== null) window.sv(live); }, 50); };
window.svPaint = (pic, e, to_say) => {
  if (!e.shiftKey) return;
  e.preventDefault();
  const b = pic.getBoundingClientRect(), at = e => [Math.min(1, Math.max(0, (e.clientX - b.left) / b.width)), Math.min(1, Math.max(0, (e.clientY - b.top) / b.height))];
  const from = at(e), band = document.createElement('div');
  band.className = 'svband';
  pic.appendChild(band);
  const move = e => { const to = at(e); band.style.left = 100 * Math.min(from[0], to[0]) + '%'; band.style.top = 100 * Math.min(from[1], to[1]) + '%'; band.style.width = 100 * Math.abs(to[0] - from[0]) + '%'; band.style.height = 100 * Math.abs(to[1] - from[1]) + '%'; };
  const up = e => { window.removeEventListener('mousemove', move); window.removeEventListener('mouseup', up); band.remove(); const to = at(e); if (Math.abs(to[0] - from[0]) > .004 && Math.abs(to[1] - from[1]) > .004) window.sv(to_say + [...from, ...to].map(v => v.toFixed(5)).join(',')); };
  window.addEventListener('mousemove', move);
  window.addEventListener('mouseup', up);
};
window.svTab = name => { const t = [...document.querySelectorAll('[role=tab]')].find(e => e.textContent.trim() === name); if (t) for (const k of ['pointerdown', 'mousedown', 'pointerup', 'mouseup', 'click']) t.dispatchEvent(new (k.startsWith('p') ? PointerEvent : MouseEvent)(k, {bubbles: true, button: 0, pointerId: 1, isPrimary: true})); };
if (!window.svTags) {
  let tags = [];
  const host = document.createElement('div');
  host.className = 'svhost';
  window.svTags = list => {
    tags = list;
    host.replaceChildren();
    const parent = window.__viserMutable.canvas.parentElement.parentElement;
    if (host.parentElement !== parent) parent.appendChild(host);
    for (const t of tags) {
      const d = document.createElement('div');
      d.className = 'svtag' + (t.strong ? '' : ' weak');
      d.style.setProperty('--c', t.color);
      const lum = .3 * parseInt(t.color.slice(1, 3), 16) + .59 * parseInt(t.color.slice(3, 5), 16) + .11 * parseInt(t.color.slice(5, 7), 16);
      if (lum > 190) { d.style.color = '#111'; d.style.textShadow = 'none'; }
      d.textContent = t.text + ' ';
      const i = document.createElement('i');
      i.textContent = t.detail;
      d.appendChild(i);
      host.appendChild(d);
      t.div = d;
    }
  };
  const place = () => {
    const m = window.__viserMutable;
    if (m && m.camera && tags.length) {
      const v = new m.camera.position.constructor(), W = m.canvas.clientWidth, H = m.canvas.clientHeight, put = [];
      for (const t of tags) {
        const node = m.nodeRefFromName[t.node];
        if (!node) { t.div.style.display = 'none'; continue; }
        node.updateWorldMatrix(true, false);
        v.setFromMatrixPosition(node.matrixWorld).project(m.camera);
        t.div.style.display = v.z > 1 ? 'none' : '';
        if (v.z > 1) continue;
        if (!t.w) { t.w = t.div.offsetWidth; t.h = t.div.offsetHeight; }
        t.x = (v.x + 1) / 2 * W - t.w / 2;
        t.y = (1 - v.y) / 2 * H - t.h;
        if (t.x > -t.w && t.x < W && t.y > -t.h && t.y < H) { t.x = Math.min(Math.max(t.x, 2), W - t.w - 2); t.y = Math.min(Math.max(t.y, 2), H - t.h - 2); }
        put.push(t);
      }
      put.sort((a, b) => b.strong - a.strong);
      put.forEach((t, k) => {
        for (let n = 0; n < 8 && put.length < 30; n++) {
          const o = put.slice(0, k).find(o => t.x < o.x + o.w && o.x < t.x + t.w && t.y < o.y + o.h && o.y < t.y + t.h);
          if (!o) break;
          t.y = o.y + o.h + 1;
        }
        t.div.style.transform = `translate(${t.x.toFixed(1)}px,${t.y.toFixed(1)}px)`;
      });
    }
    requestAnimationFrame(place);
  };
  place();
  window.addEventListener('keydown', e => {
    const a = document.activeElement;
    if (e.key === 'Enter' && a && a.tagName === 'INPUT' && a.closest('form')) { window.sv('ask:' + a.value); setTimeout(() => a.blur()); }
    /* Keys act on the page again once a field is left; a field in a dialog goes with the dialog. */
    if (e.key === 'Escape' && a && (a.tagName === 'INPUT' || a.tagName === 'TEXTAREA') && !a.closest('[role=dialog]')) a.blur();
    if (a && (a.tagName === 'INPUT' || a.tagName === 'TEXTAREA')) return;
    if (e.key === 'Escape') window.sv('close-help');
    if (e.key === '?') { e.preventDefault(); window.sv('help'); }
    if (e.key === '/') {
      const box = [...document.querySelectorAll('input')].find(i => i.placeholder === '' && i.closest('form'));
      const field = box || document.querySelector('form input');
      if (field) { e.preventDefault(); field.focus(); field.select(); }
    }
  });
}
const hello = n => { const m = window.__viserMutable; if (m && m.sendMessage) { window.sv('hello:' + (sessionStorage.getItem('sv') || '') + '&author=' + encodeURIComponent(localStorage.getItem('svAuthor') || '')); } else if (n < 40) { setTimeout(() => hello(n + 1), 250); } };
hello(0);
})()
"""
