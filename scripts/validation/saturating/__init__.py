"""Sixty machines of saturating iron that no map was tuned to: devices, steels, and their combinations."""
