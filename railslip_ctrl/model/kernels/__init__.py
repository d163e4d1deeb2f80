"""Compiled loops: the plant's scalar functions and a loop around them, put together as text, compiled and kept.

`text` puts the modules together, `compilation` compiles them by numba, `slots` names what a text finds in its module.
"""
