"""Principal permeabilities and ensembles in the dataset of a study."""

import numpy as np
import pytest
import xarray as xr

from demflow import sweep
from demflow.sweep.dataset.permeability import members_of, principal

STUDY = """\
study: ensemble
scene:
  region: {shape: rectangle, width: 2 m, height: 1.6 m}
  grains: {count: 60, porosity: 0.17, seed: 1}
  matrix: {aperture: 10 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures: {f: {kind: trace, from: [-0.5, -0.3], to: [0.5, 0.3], aperture: 50 um}}
vary:
  opening: {parameter: fractures.f.aperture, values: [20 um, 50 um]}
  seed: {parameter: grains.seed, values: [1, 2, 3]}
observe: [permeability, periodic_permeability]
"""


def test_principal_values_are_those_of_numpy():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(50, 2, 2))
    tensors = root @ root.transpose(0, 2, 1)
    found = principal(tensors)
    values, vectors = np.linalg.eigh(tensors)
    np.testing.assert_allclose(found["permeability_smallest"], values[:, 0], rtol=1e-9)
    np.testing.assert_allclose(found["permeability_largest"], values[:, 1], rtol=1e-9)
    angle = np.radians(found["permeability_direction"])
    along = np.stack([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(np.abs((along.T * vectors[:, :, 1]).sum(axis=1)), 1.0, rtol=1e-9)


def test_members_without_a_result_are_left_out():
    tensors = np.random.default_rng(2).normal(size=(4, 3, 2, 2))
    tensors[1, 0] = np.nan
    tensors[2, :2] = np.nan
    tensors[3] = np.nan
    found = members_of(tensors, 1)
    np.testing.assert_array_equal(found["ensemble_members"], [3, 2, 1, 0])
    np.testing.assert_allclose(found["permeability_mean"][1], tensors[1, 1:].mean(axis=0))
    expected = tensors[0].std(axis=0, ddof=1) / np.sqrt(3.0)
    np.testing.assert_allclose(found["permeability_error"][0], expected)
    assert np.isnan(found["permeability_error"][2:]).all()
    assert np.isnan(found["permeability_mean"][3]).all()


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_the_dataset_has_them_along_the_right_axes(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    dataset = sweep.run(path, results=tmp_path)
    tensor = dataset["permeability"]
    assert dataset["permeability_largest"].dims == ("opening", "seed")
    trace = tensor.sel(row="x", column="x") + tensor.sel(row="y", column="y")
    sums = dataset["permeability_largest"] + dataset["permeability_smallest"]
    np.testing.assert_allclose(sums, trace, rtol=1e-12)
    assert dataset["permeability_error"].dims == ("opening", "row", "column")
    np.testing.assert_allclose(dataset["permeability_mean"], tensor.mean("seed"), rtol=1e-12)
    expected = tensor.std("seed", ddof=1) / np.sqrt(3.0)
    np.testing.assert_allclose(dataset["permeability_error"], expected, rtol=1e-12)
    assert dataset["permeability_error"].attrs["ensemble"] == "seed"
    np.testing.assert_array_equal(dataset["ensemble_members"], 3)
    periodic = dataset.demflow.permeability("periodic_permeability")
    linear = dataset.demflow.permeability()
    xr.testing.assert_equal(linear["largest"], dataset["permeability_largest"])
    assert (periodic["largest"] <= linear["largest"]).all()
    assert (periodic["smallest"] > 0.0).all()
