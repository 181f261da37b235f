"""Shared code of the experiments in `lab/`. Needs only the standard library of Python 3.11.

Each module has one subject: `program` finds and builds programs, `processes` starts and ends them, `ports` finds free addresses,
`machines` makes network namespaces, `fleet` writes fleets and scenarios, `sampling` reads processor time and memory, `reports` reads
the output of `downbeat`, `shares` compares shares, and `tables` prints rows.
"""
