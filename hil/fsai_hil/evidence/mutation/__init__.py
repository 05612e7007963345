"""Mutation testing of supervisor, gate and what they lean on: does a test fail when the code says something else?

A mutant is the source with one small mistake in it. It is killed when a test fails; one that survives shows a missing
test, dead code, or a change that nobody can tell from outside. The last kind is listed with its reason in
`tests/evidence/survivors.toml`; anything else that survives fails the command.

`mutants` makes the mistakes, `trial` runs the tests against each in a forked process, `__main__` is the command.
"""
