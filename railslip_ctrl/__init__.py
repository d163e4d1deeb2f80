"""railslip_ctrl: wheel-slip control design for trains."""
