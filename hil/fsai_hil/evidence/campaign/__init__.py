"""The fault campaign: every kind of fault at random moments of every mission, judged by what the safety rules demand.

- `catalogue` lists the kinds of fault, one row each; `injections` does them to a run; `demands` says in the safety
  rules' own terms what must follow.
- `cases` makes case N of seed S, from the two numbers alone.
- `scenario` drives one case, `observation` writes down what was seen from outside, `verdict` judges it.
- `runner` spreads cases over processes, or over a Dask cluster; `table` shows their results.
- `explain` shows one run to a person.

Nothing here looks into the bridge to judge it: what counts is what was on the bus and what the car really did.
"""
