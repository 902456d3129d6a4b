# SPDX-License-Identifier: Apache-2.0
"""Calibrates a small servo arm from recordings: those in the folder given, or fresh ones of the stand-in arm.

Usage: python examples/calibrate_arm.py [FOLDER OF CSV FILES]
"""

import sys
import tempfile
from pathlib import Path

from trueup import prepare, read, write_report
from trueup.calibration import pooled_rmse
from trueup.studies.servo_arm.demo import model_path, record

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="arm-"))
if len(sys.argv) == 1:
    record(folder)

# ---- the ten lines ----
recordings = [r for path in sorted(folder.glob("*.csv")) for r in read(path)]
training, held_out = recordings[:-1], recordings[-1:]
ready = prepare(model_path(), training, held_out)  # proposes what to calibrate
print(*ready.notes, sep="\n")
calibration = ready.calibrate()
for estimate in calibration.estimates:
    print(f"{estimate.name:26} {estimate.start:9.4g} -> {estimate.value:9.4g} {estimate.unit:12} {estimate.verdict}")
before, after = (1e3 * pooled_rmse(calibration.held_out(), after=x) for x in (False, True))
print(f"held out ({held_out[0].name}): {before:.1f} -> {after:.1f} mrad")
ready.write(calibration, folder / "calibrated.xml", folder / "parameters.toml")
write_report(calibration, folder / "report.html")
