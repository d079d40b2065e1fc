"""Kinds of constraints: a file each, with a function that makes the row of one constraint (see ``_warp``)."""
