"""The design page: a loop shaped by hand in the browser, on this machine alone.

Imports `report`, `simulation`, `design`, `controllers`, `loop`, `model` and `core`. Begin with `answers`: what the page
asks, and how the functions that the commands use answer it. `server` serves it on 127.0.0.1, `notebook` shows it in a
notebook. `static/` is the page: it draws and asks, and computes no control theory.
"""
