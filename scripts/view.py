"""Save a picture of a device, with the field of a map if one is given.

python scripts/view.py drive_unit maps/out/workspace.h5 --amperes 1.5 --output docs/images/drive_unit.png
"""

import argparse
from pathlib import Path

import fieldmap
from fieldmap.device.measured import measured_on
from fieldmap.plot import save_picture


def main() -> None:
    """Read the arguments, draw, and print the path of the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("device", help="device file, or the name of a shipped device")
    parser.add_argument("map", nargs="?", help="map file of the device")
    parser.add_argument("--amperes", type=float, default=1.0, help="current in every coil")
    parser.add_argument(
        "--sensor-mm", type=float, help="draw the payload's magnet at this reading of the machine's sensor"
    )
    parser.add_argument("--output", type=Path, default=Path("device.png"))
    given = parser.parse_args()
    device = fieldmap.read_device(given.device)
    field = fieldmap.open_map(given.map) if given.map else None
    magnet_at = None
    machine = measured_on(device.name, len(device.coils))
    if given.sensor_mm is not None and device.payload is not None and machine is not None:
        magnet_at = (0.0, 0.0, machine.height(given.sensor_mm, device.payload.magnet_offset))
    currents = [given.amperes] * len(device.coils)
    given.output.parent.mkdir(parents=True, exist_ok=True)
    caption = field.info.provenance.title if field is not None else ""
    print(save_picture(given.output, device, field, currents, magnet_at, caption))


if __name__ == "__main__":
    main()
