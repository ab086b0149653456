"""How the page looks: light and dark by the reader's setting, and on paper."""

from __future__ import annotations

from pipeline.geometry.palette import Role, hex_color, palette


def _roles(dark: bool) -> str:
    roles: tuple[Role, ...] = ("target", "reference", "truth")
    return "".join(f" --{name}: {hex_color(palette(dark)[name])};" for name in roles)


_DARK = f"""color-scheme: dark; --page: #0f1216; --card: #171b21; --sunk: #11151a; --ink: #e9edf2; --quiet: #98a2b0;
  --line: #2a313a; --fail: #ff7a85; --fail-soft: #3a1d22; --soft: #1e242c; --track: #2b323c;{_roles(True)}"""
_LIGHT = f"""color-scheme: light; --page: #f5f6f8; --card: #ffffff; --sunk: #eef0f3; --ink: #161b22; --quiet: #5a6472;
  --line: #dfe3e8; --fail: #bd1f36; --fail-soft: #fbe9ec; --soft: #f1f3f6; --track: #e3e7ec;{_roles(False)}"""

STYLE = f"""
:root {{ {_LIGHT} }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ {_DARK} }} }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: var(--page); color: var(--ink); -webkit-font-smoothing: antialiased;
  font: 14px/1.5 Inter, "Segoe UI", -apple-system, "Helvetica Neue", "Liberation Sans", Arial, system-ui, sans-serif; }}
main {{ max-width: 1400px; margin: 0 auto; padding: 28px 32px 56px; }}
header {{ padding: 0 2px 18px; }}
.eyebrow {{ display: flex; flex-wrap: wrap; gap: 8px 12px; align-items: center; color: var(--quiet); font-size: 13px; }}
.verdict {{ font-weight: 650; font-size: 12px; letter-spacing: .04em; padding: 3px 10px; border-radius: 999px;
  background: var(--fail-soft); color: var(--fail); white-space: nowrap; }}
.verdict.correct {{ color: var(--truth); background: var(--soft); }}
.verdict.none {{ color: var(--quiet); background: var(--soft); }}
h1 {{ font-size: 25px; line-height: 1.28; font-weight: 620; letter-spacing: -.012em; margin: 12px 0 0; max-width: 58em;
  text-wrap: pretty; overflow-wrap: anywhere; }}
.lead {{ font-size: 15.5px; color: var(--quiet); margin: 6px 0 0; max-width: 70em; overflow-wrap: anywhere; }}
.asked-for {{ color: var(--ink); font-weight: 550; overflow-wrap: anywhere; }}
.asked-for .target, td.name.target {{ color: var(--target); }}
.asked-for .reference, td.name.reference {{ color: var(--reference); }}
h2 {{ font-size: 13px; font-weight: 620; margin: 0 0 12px; }}
h3 {{ font-size: 13px; font-weight: 600; margin: 18px 0 4px; }}
.card {{ background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 16px 18px 18px;
  min-width: 0; }}
.views, .columns {{ display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 16px; margin-top: 16px; }}
.views.one {{ grid-template-columns: minmax(0, 1fr); }}
.views.one .picture {{ max-height: 70vh; }}
figure {{ margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 10px; overflow: hidden;
  display: flex; flex-direction: column; }}
.picture {{ display: block; width: 100%; height: auto; background: #101318; flex: 1; }}
iframe {{ border: 0; width: 100%; flex: 1; min-height: 380px; background: #14171c; display: block; }}
figcaption {{ padding: 9px 14px; color: var(--quiet); font-size: 12.5px; display: flex; flex-wrap: wrap; gap: 4px 16px;
  border-top: 1px solid var(--line); }}
.key {{ display: inline-flex; align-items: center; gap: 6px; white-space: nowrap; }}
.key::before {{ content: ""; width: 12px; height: 12px; border-radius: 3px; background: var(--c); }}
.key.dashed::before {{ background: none; border: 2px dashed var(--c); }}
.picture path {{ fill: none; stroke-linejoin: round; stroke-linecap: round; }}
.picture .target {{ --c: {hex_color(palette(True)["target"])}; }}
.picture .reference {{ --c: {hex_color(palette(True)["reference"])}; }}
.picture .truth {{ --c: {hex_color(palette(True)["truth"])}; }}
.picture path.mask {{ fill: var(--c); fill-opacity: .26; fill-rule: evenodd; stroke: var(--c);
  stroke-width: calc(1.3px * var(--u)); }}
.picture path.box {{ stroke: var(--c); stroke-width: calc(1.6px * var(--u)); stroke-opacity: .95; }}
.picture path.true {{ stroke: {hex_color(palette(True)["truth"])}; stroke-width: calc(2px * var(--u));
  stroke-dasharray: calc(5px * var(--u)) calc(4px * var(--u)); }}
.picture .tag rect {{ fill: var(--c); }}
.picture .tag text {{ fill: #14171c; font-weight: 600; }}
.modules {{ list-style: none; display: grid; grid-template-columns: repeat(6, 1fr); gap: 1px; margin: 0; padding: 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }}
.modules li {{ background: var(--card); padding: 10px 14px; display: grid; gap: 0 8px;
  grid-template-columns: 1fr auto; }}
.modules b {{ font-weight: 620; }} .modules span {{ color: var(--quiet); grid-row: 2; font-size: 12.5px; }}
.modules em {{ font-style: normal; font-variant-numeric: tabular-nums; color: var(--quiet); }}
.modules .blamed {{ background: var(--fail-soft); box-shadow: inset 0 3px 0 var(--fail); }}
.modules .blamed b {{ color: var(--fail); }}
.sr {{ position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }}
.scroll {{ overflow-x: auto; }}
table {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 6px 10px; text-align: right; white-space: nowrap; vertical-align: middle; }}
th:first-child, td:first-child {{ text-align: left; padding-left: 4px; }}
td:last-child, th:last-child {{ padding-right: 4px; }}
thead th {{ color: var(--quiet); font-weight: 500; font-size: 12.5px; border-bottom: 1px solid var(--line);
  vertical-align: bottom; }}
thead small {{ display: block; font-size: 11.5px; color: var(--quiet); max-width: 18em; overflow: hidden;
  text-overflow: ellipsis; margin-left: auto; }}
tbody th {{ font-weight: 500; }}
tbody tr + tr > * {{ border-top: 1px solid var(--line); }}
.name {{ text-align: left; font-weight: 550; max-width: 16em; overflow: hidden; text-overflow: ellipsis; }}
tr.winner > * {{ background: var(--soft); }}
tr.gap td {{ text-align: center; color: var(--quiet); padding: 0; }}
.chip {{ font-size: 11px; font-weight: 600; color: var(--truth); border: 1px solid currentcolor; border-radius: 999px;
  padding: 0 7px; margin-left: 6px; }}
tr.asked > * {{ background: var(--soft); font-weight: 620; }}
.state {{ text-align: center; color: var(--quiet); }}
.meter {{ display: inline-block; width: 64px; height: 6px; border-radius: 3px; overflow: hidden;
  background: var(--track);
  vertical-align: middle; margin-right: 8px; }}
.meter span {{ display: block; height: 100%; background: var(--quiet); }}
.asked .meter span, .winner .meter span {{ background: var(--ink); }}
.number {{ display: inline-block; min-width: 3em; }}
.wide {{ width: 38%; min-width: 150px; }}
.axis {{ display: block; position: relative; height: 14px;
  background: linear-gradient(var(--line), var(--line)) 50% 0 / 1px 100% no-repeat; }}
.bar {{ position: absolute; top: 2px; height: 10px; border-radius: 2px; min-width: 2px; }}
.bar.ours {{ left: 50%; background: var(--fail); }} .bar.theirs {{ right: 50%; background: var(--truth); }}
tr.sum > * {{ font-weight: 620; }}
th.hint {{ font-size: 11.5px; text-align: center; }} th.hint span {{ display: inline-block; width: 50%; }}
th.hint span:first-child {{ text-align: right; padding-right: 6px; }}
th.hint span + span {{ text-align: left; padding-left: 6px; }}
.needed {{ margin: 0; padding-left: 18px; }} .needed li::marker {{ color: var(--quiet); }}
.quiet {{ color: var(--quiet); font-size: 12.5px; margin: 10px 0 0; }}
dl.facts {{ display: grid; grid-template-columns: max-content 1fr; gap: 4px 20px; margin: 0; }}
dl.facts dt {{ color: var(--quiet); }} dl.facts dd {{ margin: 0; overflow-wrap: anywhere; }}
pre {{ margin: 0 0 10px; background: var(--sunk); border: 1px solid var(--line); border-radius: 7px; padding: 10px 12px;
  font: 12.5px/1.55 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; white-space: pre-wrap;
  overflow-wrap: anywhere; }}
pre.state {{ text-align: left; color: inherit; max-height: 8.5em; overflow: auto; }}
section {{ margin-top: 16px; }}
footer {{ margin-top: 20px; color: var(--quiet); font-size: 12.5px; }}
@media (max-width: 1000px) {{ .views, .columns {{ grid-template-columns: minmax(0, 1fr); }}
  .modules {{ grid-template-columns: repeat(3, 1fr); }} main {{ padding: 20px 16px 40px; }} }}
@media print {{
  :root {{ {_LIGHT} --page: #fff; }}
  body {{ font-size: 10.5px; }} main {{ max-width: none; padding: 0; }} h1 {{ font-size: 17px; }}
  figure.scene {{ display: none; }} .views, .columns {{ grid-template-columns: minmax(0, 1fr); gap: 10px; }}
  .picture {{ max-height: 46vh; }} .card, figure, .modules {{ break-inside: avoid; }}
  th, td {{ padding: 3px 6px; }} pre.state {{ max-height: none; }}
  * {{ print-color-adjust: exact; -webkit-print-color-adjust: exact; }}
}}
"""
