# SPDX-License-Identifier: Apache-2.0
"""The report of an identification answers its questions, is loud where nothing was held out, and escapes what users name."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from trueup.identification.estimation.result import (
    Identification,
    Parameter,
    relative_error,
)
from trueup.report.identification import identification_html, write_identification_report
from trueup.report.identification_figures import binned
from trueup.report.identification_files import usage


def test_every_question_is_answered(found: Identification, tmp_path: Path) -> None:
    page = write_identification_report(found, tmp_path / "out" / "report.html", context={"command": "trueup ..."})
    text = page.read_text("utf-8")
    for answer in (
        "on motion that was held out",
        "Accelerate elbow harder",
        "torque comes late",
        "mass -1 kg",
        "trueup ...",
    ):
        assert answer in text
    assert f"{100 * relative_error(found.held_out()):.2f}" in text
    assert "unseen" in text
    assert "<script" not in text
    assert "http" not in text.replace("http://www.w3.org", "")


def test_a_fit_without_anything_held_out_is_not_dressed_up(found: Identification) -> None:
    bare = replace(found, predictions=found.predictions[:1])
    text = identification_html(bare)
    assert "nothing was held out" in text
    assert "on motion that was held out" not in text


def test_currents_are_not_called_torque_nor_compared_with_that_of_the_file(found: Identification) -> None:
    assert "by the model file as it was given" in identification_html(found)
    in_amperes = replace(found, units=("A",) * len(found.joints))
    assert "by the model file as it was given" not in identification_html(in_amperes)
    assert usage(in_amperes).endswith("rad/s² to A")
    assert usage(found).endswith("rad/s² to N m")


def test_names_of_users_are_escaped_and_the_page_is_well_formed(found: Identification) -> None:
    class Balance(HTMLParser):
        open: list[str] = []  # noqa: RUF012

        def handle_starttag(self, tag: str, attrs: object) -> None:
            if tag not in ("meta", "wbr", "br", "input", "line", "path", "rect", "circle", "polygon", "link"):
                self.open.append(tag)

        def handle_endtag(self, tag: str) -> None:
            if tag not in ("line", "path", "rect", "circle", "polygon"):
                assert self.open.pop() == tag

    text = identification_html(found)
    assert "a<b>" not in text
    reader = Balance()
    reader.feed(text)
    assert reader.open == []


def test_friction_that_a_model_lacks_shows_as_a_mean_error_beside_zero(rng: np.random.Generator) -> None:
    v = rng.uniform(-1.0, 1.0, 3000)
    centre, mean, _, low, high = binned(v, 0.5 * np.sign(v) + rng.normal(size=v.shape))
    outer = np.abs(centre) > 0.2
    assert np.all((low * np.sign(centre) > 0.0)[outer] | (high * np.sign(centre) > 0.0)[outer])
    assert np.abs(mean - 0.5 * np.sign(centre))[outer].max() < 0.3


def test_errors_of_slides_and_hinges_are_not_drawn_on_one_scale(found: Identification) -> None:
    alike = identification_html(found)
    mixed = identification_html(replace(found, units=("N", "N m"), prismatic=(True, False)))
    assert "error in N m" in alike
    assert "error in N, N m" not in mixed
    assert "mean torque" in mixed  # the share of each joint's own torque in its place
    assert "force in N" in mixed


def test_the_table_of_parameters_is_short_until_opened_and_its_symbols_are_explained(found: Identification) -> None:
    friction = Parameter(
        "ft0.0151_2", "N m", "saturating", "elbow", 2.0, 0.1, np.nan, np.nan, "shared", "sets in with speed"
    )
    text = identification_html(replace(found, parameters=(*found.parameters, friction)))
    table = text.index('id="numbers"')
    assert text.rfind("<details", 0, table) > text.rfind("</details>", 0, table)
    assert "<dt>ft</dt><dd>sets in with speed</dd>" in text
    assert "2 elbow" in text
