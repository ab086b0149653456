"""CSS of what two detectors agree on."""

BESIDE_CSS = """<style>
.sv .hollow{display:inline-block;width:9px;height:9px;box-sizing:border-box;border:1.5px dashed var(--c);border-radius:2px;margin-right:6px;flex:none}
.sv .agree{display:flex;height:8px;border-radius:2px;overflow:hidden;gap:1px;margin:2px 0 4px}
.sv .agree i{background:var(--c);min-width:2px}
.sv .agree i.second{background:repeating-linear-gradient(90deg,var(--c) 0 5px,color-mix(in srgb,var(--c) 35%,transparent) 5px 8px)}
.sv .agree+.legend{gap:2px 12px}
.sv .kappas{display:grid;grid-template-columns:repeat(4,1fr);gap:6px;padding:5px 0 3px;font-size:11px;line-height:1.25}
.sv .kappas b{display:block;color:var(--mantine-color-text);font-size:13px;font-variant-numeric:tabular-nums}
.sv table.apart{table-layout:fixed}
.sv table.apart td{padding:2px 3px;overflow:hidden;text-overflow:ellipsis}
.sv table.apart col.s{width:38px}
.sv table.apart td:nth-child(3),.sv table.apart th:nth-child(3){padding-left:12px}
.sv table.apart td:first-child,.sv table.apart th:first-child{padding-left:9px}
.sv table.apart .name{display:flex;align-items:center}
.sv table.apart .name b{overflow:hidden;text-overflow:ellipsis}
.sv table.apart td.none{color:color-mix(in srgb,var(--mantine-color-dimmed) 60%,transparent)}
</style>"""
