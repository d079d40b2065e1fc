"""Checks of arrays from outside against the rules of the field tables, before a kernel goes by them.

A scene or a run that was made here passes; a wrong index, type, offset, colour or number is named with its array,
place, value and limit. Arrays are NumPy's and have the dtypes and shapes of their fields already. No loop in Python
runs over worlds. What is large is looked at by compiled code first (``glance``), which tells that all is right; what it
does not pass, and what is small, NumPy goes through, part by part within the processor's cache, and words the error. A
check costs a few percent of what reads or makes the arrays.
"""
