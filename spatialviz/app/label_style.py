"""CSS of the Review tab."""

LABEL_CSS = """<style>
.sv .prog{height:7px;border-radius:4px;overflow:hidden;background:color-mix(in srgb,var(--mantine-color-dimmed) 25%,transparent);margin:3px 0}
.sv .prog i{display:block;height:100%;background:var(--mantine-primary-color-filled);transition:width .3s}
.sv details{font-size:11.5px;margin:1px 0}
.sv summary{cursor:pointer;color:var(--mantine-color-dimmed)}
.sv .cellrow{display:flex;gap:8px;padding:1px 4px;margin:0 -4px;border-radius:3px;cursor:pointer}
.sv .cellrow:hover{background:var(--mantine-color-default-hover)}
.sv .cellrow span:first-child{flex:1;min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .cellrow .n{white-space:nowrap}
.sv .vrow2{display:flex;flex-wrap:wrap;gap:0 10px;padding-top:2px}
.sv .inst{display:flex;gap:6px;align-items:center;padding:5px 0 2px}
.sv .inst .find{flex:1;padding:1px 8px}
.sv .path{font-size:11px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;direction:rtl;text-align:left}
</style>"""
