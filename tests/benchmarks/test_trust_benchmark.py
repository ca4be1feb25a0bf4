"""What the calibration benchmark says of rows that it cannot use."""

from pathlib import Path

import calibration
import pytest

from reorient.experiments.cells import COLUMNS
from reorient.runs.files import write_table


def test_rows_without_a_confidence_are_refused_in_a_line(tmp_path: Path):
    write_table(tmp_path / "rows.csv.gz", [dict.fromkeys(COLUMNS, "0") | {"estimator": "gicp"}])
    with pytest.raises(SystemExit, match="no confidences of 'gicp' in .*: expected rows that have one"):
        calibration.main(calibration.Calibration(tmp_path, estimator="gicp"))
