"""Mutation testing of supervisor and gate: does a test of theirs fail when the code says something else?"""
