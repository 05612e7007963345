"""The one judgement of a log: `judging.judged` makes it, `verdict.Verdict` is it."""
