"""The design page, on which a user shapes the loop by hand in the browser; only this machine can reach it.

Imports `report`, `simulation`, `design`, `controllers`, `loop`, `model` and `core`. Begin with `answers`, which
answers the requests of the page with the functions that the commands use. `server` serves the page on 127.0.0.1,
`notebook` shows it in a notebook. `static/` is the page itself: it draws and sends requests, and computes no control
theory.
"""
