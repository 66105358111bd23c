"""From a device to solved iron: linear, saturating, with hysteresis, and refined to a tolerance."""
