"""Kinds of fault by what fails: each module has what does them to a run, and a row for each."""
