"""Which devices a map with memory can be made of."""

from fieldmap.device.materials import SaturatingMaterial
from fieldmap.device.model import Device
from fieldmap.errors import RecipeError
from fieldmap.inputs.document import AtKey


def require_hysteresis(device: Device) -> None:
    """Raise RecipeError unless some of a device's iron has a coercive field, and there is no background field."""
    materials = [device.materials[body.material] for body in device.bodies]
    soft = [one for one in materials if isinstance(one, SaturatingMaterial)]
    problems = []
    if not any(one.coercive_field > 0.0 for one in soft):
        must_hold = "a device with iron that has hysteresis"
        remedy = 'give a material of the device coercive_field_A_per_m, or write model = "saturating"'
        problems.append(AtKey("iron.model", must_hold, "no material with a coercive field", remedy))
    if device.background is not None:
        must_hold, remedy = "a device without [background] for iron with hysteresis", "leave it out"
        problems.append(AtKey("iron.model", must_hold, "a background field", remedy))
    if problems:
        raise RecipeError(*problems)
