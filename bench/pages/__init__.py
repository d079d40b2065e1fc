"""From the records of ``bench/results/results.jsonl`` to Markdown: the page ``docs/measured.md``, the README's figures.

A function for each bench takes its record, the values under the keys that its module measures, and gives the Markdown
of its section; ``page`` puts them together.
"""
