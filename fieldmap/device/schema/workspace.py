"""Where the payload may go, [workspace], and known values to hold results against, [[reference]]."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import Field, Tag

from fieldmap.device import parts as model
from fieldmap.inputs.declared import choice_of, record_of, table_of
from fieldmap.inputs.tables import Table, chosen_with

WORKSPACE_KEYS: dict[type, Any] = {
    space: table_of(space, "shape") for space in (model.WorkspaceBox, model.WorkspaceCylinder)
}

if TYPE_CHECKING:
    AnyWorkspace: TypeAlias = Table
else:
    AnyWorkspace = choice_of(WORKSPACE_KEYS.values(), "shape")

_REFERENCE: Any = table_of(model.Reference)


class FluxDensityReference(_REFERENCE):
    """A known component of B."""

    quantity: Literal["Bx", "By", "Bz"] = Field(description="component of the flux density")
    value_T: float = Field(description="its value")

    def to_model(self) -> model.Reference:
        """In SI."""
        return _reference(self, self.quantity, self.value_T)


class GradientReference(_REFERENCE):
    """A known entry of the gradient of B."""

    quantity: Literal[
        "dBx/dx", "dBx/dy", "dBx/dz", "dBy/dx", "dBy/dy", "dBy/dz", "dBz/dx", "dBz/dy", "dBz/dz"
    ] = Field(description="entry of the gradient")
    value_T_per_m: float = Field(description="its value")

    def to_model(self) -> model.Reference:
        """In SI."""
        return _reference(self, self.quantity, self.value_T_per_m)


def _reference(keys: Table, quantity: str, value: float) -> model.Reference:
    reference: model.Reference = record_of(keys, quantity=quantity, value=float(value))
    return reference


QUANTITIES = ("Bx", "By", "Bz", *(f"dB{i}/d{j}" for i in "xyz" for j in "xyz"))


def _kind_of_reference(table: dict[str, Any]) -> Any:
    quantity = table.get("quantity")
    if quantity not in QUANTITIES:
        return quantity
    return "flux density" if quantity.startswith("B") else "gradient"


AnyReference = Annotated[
    Annotated[FluxDensityReference, Tag("flux density")] | Annotated[GradientReference, Tag("gradient")],
    chosen_with(_kind_of_reference, "quantity"),
]
