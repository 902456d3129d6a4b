# SPDX-License-Identifier: Apache-2.0
"""Tests of folders of results."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from trueup.campaign.output import Output, free_folder
from trueup.errors import OutputError

_HOLD = (
    "import sys; from pathlib import Path; from trueup.campaign.output import free_folder as f; f(Path(sys.argv[1])); \
print('held', flush=True); sys.stdin.read()"
)


def test_a_folder_that_another_process_writes_to_is_passed_by(tmp_path: Path) -> None:
    """Two that begin at once both find it empty."""
    at, model = tmp_path / "fit", tmp_path / "arm.xml"
    with subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(at)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        own = Output.open(at, model, "print")
        assert own.folder == tmp_path / "fit-2"
        assert own.note == f"{at} is written to by another process, so these go to {own.folder}"
        with pytest.raises(OutputError, match="another process writes its results there"):
            Output.open(at, model, "print", force=True)
        other.communicate()
    assert free_folder(at) == at  # nothing is left of who held it
    assert Output.open(at, model, "print").folder == at  # one's own stays one's own
