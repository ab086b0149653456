"""Which module failed, why, and what smallest change would mend it.

`frame_evidence` joins what was detected in a frame with what is true of it,
`substitution` ranks again with parts of the pipeline replaced by the truth,
`decision` names the module, `verdict` says it in words, `asking` answers and
judges, `cases` keeps answers, `whatif` edits them.
"""
