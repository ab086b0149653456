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
.sv .asks{display:flex;flex-wrap:wrap;gap:4px;font-size:11.5px;padding:1px 0 3px}
.sv .queue{max-height:max(140px,calc(50vh - 330px));overflow:auto;margin:0 -4px}
.sv .q{display:grid;grid-template-columns:26px 1fr auto auto;gap:6px;align-items:center;padding:1px 4px;border-radius:3px;cursor:pointer}
.sv .q:hover{background:var(--mantine-color-default-hover)}
.sv .q.sel{background:color-mix(in srgb,var(--mantine-primary-color-filled) 20%,transparent);box-shadow:inset 3px 0 0 var(--mantine-primary-color-filled)}
.sv .q i{height:6px;border-radius:2px;background:linear-gradient(to right,#e0982e calc(var(--v)*100%),color-mix(in srgb,var(--mantine-color-dimmed) 25%,transparent) 0)}
.sv .q span{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .q em{font-style:normal;font-size:10.5px;color:var(--mantine-color-dimmed);max-width:84px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;direction:rtl}
.sv .item{border-left:3px solid #e0982e;border-radius:0 4px 4px 0;background:color-mix(in srgb,#e0982e 9%,transparent);padding:3px 8px;margin:4px 0}
.sv .item .big{font-size:13.5px;padding:0}
.sv .item .big b{min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap}
.sv .item .big .p{font-size:15px}
.sv .item .why{font-size:11.5px;line-height:1.35;padding:1px 0 2px}
.sv .item .ways{display:flex;justify-content:space-between;gap:10px}
.sv .item .ways span:last-child{flex:none}
.sv .keys .sec{grid-column:1/-1;padding:0 0 .3em}
.sv .who{display:flex;align-items:center;gap:6px}
.sv .who .find{width:110px;padding:0 7px}
.sv .inst{display:flex;gap:6px;align-items:center;padding:5px 0 2px}
.sv .inst .find{flex:1;padding:1px 8px}
.sv .path{font-size:11px;overflow:hidden;text-overflow:ellipsis;white-space:nowrap;direction:rtl;text-align:left}
</style>"""
