"""Kinds of constraints: a file each, with a function that makes the row of one constraint.

A new joint is a new file, its arrays in ``model.fields.JOINTS``, and a branch in the loop of ``pack`` over the
joints, which makes its row where these arrays say so; the oracle has a file with the same name.
"""
