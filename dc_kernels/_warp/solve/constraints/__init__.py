"""Kinds of constraints: a file each, with a function that makes the rows of one constraint.

A contact, and a rod in a scene whose joints are all rods, are packed as they are made (``solve.pack``). Other joints
write rows of general Jacobians (``solve.joints``), which are then packed as those of a contact solver's caller are. A
new kind of joint is a new file, its numbers in ``model.fields.JOINTS``, a line in ``model.joints.HELD``, and a branch
in ``solve.joints``; the oracle has a file with the same name.
"""
