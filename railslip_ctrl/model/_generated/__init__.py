"""Numeric plant modules, one a law, written by `python -m railslip_ctrl.model.numeric`."""
