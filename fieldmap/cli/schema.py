"""`fieldmap schema`: the JSON Schema of device files."""


def schema() -> None:
    """Print the JSON Schema of device files, for editors that check a file while you type."""
    from fieldmap.device.schema import DeviceFile
    from fieldmap.io.json_schema import schema_text

    print(schema_text(DeviceFile), end="")
