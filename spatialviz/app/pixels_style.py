"""CSS of the editor of pixels, and of its row above the picture."""

PIXELS_CSS = """<style>
.sv .pxrow{display:grid;grid-template-columns:repeat(6,1fr);gap:3px;padding-bottom:5px}
.sv .pxrow span{border:1px solid var(--mantine-color-default-border);border-radius:4px;text-align:center;padding:1px 0;font-size:11px;cursor:pointer;white-space:nowrap;overflow:hidden;text-overflow:ellipsis}
.sv .pxrow span:hover{background:var(--mantine-color-default-hover);border-color:var(--mantine-color-dimmed)}
.sv .pxrow .on{background:var(--mantine-primary-color-filled);border-color:var(--mantine-primary-color-filled);color:#fff}
.sv .pxrow .off{opacity:.4;cursor:default}
.sv .pxrow .w2{grid-column:span 2}
.svpx{position:absolute;inset:0;z-index:3;display:flex;flex-direction:column;font:12.5px/1.4 var(--mantine-font-family,system-ui);color:var(--mantine-color-text);font-variant-numeric:tabular-nums;pointer-events:none}
.svpx *{box-sizing:border-box}
.svpx .bar{pointer-events:auto;display:flex;flex-wrap:wrap;align-items:center;gap:5px 8px;padding:6px 10px;background:var(--mantine-color-body);border-bottom:1px solid var(--mantine-color-default-border)}
.svpx .bar b{max-width:220px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.svpx .grow{flex:1}
.svpx .seg{display:flex;border:1px solid var(--mantine-color-default-border);border-radius:5px;overflow:hidden}
.svpx .seg span{padding:2px 8px;cursor:pointer;border-right:1px solid var(--mantine-color-default-border);white-space:nowrap;user-select:none}
.svpx .seg span:last-child{border:0}
.svpx .seg span:hover{background:var(--mantine-color-default-hover)}
.svpx .seg .on{background:var(--mantine-primary-color-filled);color:#fff}
.svpx u{text-underline-offset:2px;text-decoration-thickness:1px}
.svpx button{font:inherit;color:inherit;border:1px solid var(--mantine-color-default-border);background:transparent;border-radius:5px;padding:2px 9px;cursor:pointer;white-space:nowrap}
.svpx button:hover{background:var(--mantine-color-default-hover)}
.svpx button:disabled{opacity:.4;cursor:default}
.svpx button.go{background:var(--mantine-primary-color-filled);border-color:var(--mantine-primary-color-filled);color:#fff}
.svpx input[type=text]{font:inherit;color:inherit;width:130px;background:var(--mantine-color-default-hover);border:1px solid var(--mantine-color-default-border);border-radius:5px;padding:2px 8px;outline:none}
.svpx input[type=text]:focus{border-color:var(--mantine-primary-color-filled)}
.svpx input[type=text].miss{border-color:#e5484d}
.svpx label{display:flex;align-items:center;gap:6px;color:var(--mantine-color-dimmed);white-space:nowrap}
.svpx label output{color:var(--mantine-color-text);min-width:42px}
.svpx input[type=range]{width:84px;accent-color:var(--mantine-primary-color-filled)}
.svpx .room{position:relative;flex:1;min-height:0;background:var(--mantine-color-body);pointer-events:auto;overflow:hidden}
.svpx .room canvas{position:absolute;inset:0;width:100%;height:100%;touch-action:none}
.svpx.slim .room{display:none}
.svpx.slim .bar{border-bottom:0;margin:6px 8px 0;border-radius:7px;box-shadow:0 1px 8px rgba(0,0,0,.35)}
.svpx .low{min-height:27px;color:var(--mantine-color-dimmed);padding-top:3px;padding-bottom:3px;border-top:1px solid var(--mantine-color-default-border)}
.svpx:not(.slim) .low{border-bottom:0}
.svpx .low{flex-wrap:nowrap}
.svpx .low .note,.svpx .low .hint{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.svpx .low .info{white-space:nowrap}
.sv .pxsaid .note{margin:0 0 6px;display:-webkit-box;-webkit-line-clamp:2;-webkit-box-orient:vertical;overflow:hidden;font-size:11.5px;padding:2px 8px}
.svpx .low .bad{color:#e5484d;font-weight:600}
.svpx .low .note{color:var(--mantine-color-text)}
.svpx .tip{position:absolute;pointer-events:none;background:rgba(20,22,26,.88);color:#fff;border-radius:4px;padding:1px 6px;font-size:11.5px;transform:translate(12px,12px);display:none}
</style>"""
