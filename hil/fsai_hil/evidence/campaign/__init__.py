"""The fault campaign: every kind of fault at random moments of every mission, judged by what the safety rules demand.

- `faults` has the kinds of fault by what fails: what does each to a run, and its row; `catalogue` lists them all,
  `endings` names how a run may end.
- `cases` makes case N of seed S, from the two numbers alone.
- `scenario` drives one case, `observation` notes what was seen from outside, `verdict` holds the end against the row.
- `runner` spreads cases over processes, or over a Dask cluster; `table` shows their results.
- `explain` shows one run to a person.

What happens on the way is judged by the checker of `rules/`, which lockstep feeds. Nothing looks into the bridge: what
counts is what was asked of it, what was on the bus, and what the car really did.
"""
