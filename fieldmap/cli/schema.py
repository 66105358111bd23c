"""`fieldmap schema`: the JSON Schema of device files."""


def schema() -> None:
    """Print the JSON Schema of device files, for editors that check a file while you type."""
    import json

    from fieldmap.device.schema import DeviceFile

    print(json.dumps(DeviceFile.model_json_schema(), indent=2))
