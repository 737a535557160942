#!/usr/bin/env bash
# compliance-checker 6.1.0 (netCDF4 1.7.4, numpy 2.4): a string coordinate variable of two or more
# values makes its check of strict monotonicity raise inside. The report shows no finding of that
# check for the file; the exception goes to the log alone. CF 1.11 (section 6.1) allows label
# coordinates that are strings; only numeric coordinate variables must be monotonic.
# Valid input: one string variable with the name of its dimension.
# Seen: the check `check_coordinate_variables_strict_monotonicity` does not return; the
# log names "unsupported operand type(s) for -: 'str' and 'str'". This script fails if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check compliance-checker==6.1.0
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import netCDF4

with netCDF4.Dataset("labels.nc", "w") as file:
    file.Conventions = "CF-1.11"
    file.createDimension("method", 2)
    label = file.createVariable("method", str, ("method",))
    label.long_name = "method"
    label[0], label[1] = "krylov", "implicit"
PY
"$folder/venv/bin/python" - <<'PY'
import netCDF4
from compliance_checker.cf.cf_1_11 import CF1_11Check

check = CF1_11Check()
file = netCDF4.Dataset("labels.nc")
check.setup(file)
try:
    check.check_coordinate_variables_strict_monotonicity(file)
except TypeError as error:
    print("raised:", error)
    assert "'str'" in str(error), error
else:
    raise SystemExit("changed: the check takes string coordinates now")
PY
