"""Sixty machines of saturating iron that nobody tuned a map to: devices, steels, and what of them stands together."""
