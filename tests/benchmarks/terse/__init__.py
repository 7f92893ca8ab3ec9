"""How much five scenes take to write, here and in the formats of others: prints lines and tokens.

    python -m tests.benchmarks.terse

Each scene is written in every format as an expert writes it by hand, with what the format has against repetition:
`repeat`, `templates` and `include` here, `default`, `replicate` and `attach` in MJCF, `add_directives` in Drake, whose
SDFormat models let the parser compute inertia (`auto`), in Drake's favor. OmniGibson writes its scenes itself, as JSON
with an indent of two; the cabinet's geometry is in a file that is not counted, in OmniGibson's favor. Ours are as
`simfoundry fmt` writes them, XML has one element per line and is wrapped at 100 columns. Comments and empty lines are
left out. A token is a word, a number or a punctuation mark; ``--write`` brings files into these forms.
"""
