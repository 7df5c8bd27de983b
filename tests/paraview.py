"""Opens what Favre wrote with VTK, PyVista and h5py; called by tests/paraview.rs with a test's name."""

import glob
import os
import sys
import xml.etree.ElementTree as xml

import h5py
import numpy as np
import pyvista
import vtk
from vtk.util.numpy_support import vtk_to_numpy

UNITS = {
    "solids_fraction": "-",
    "solids_velocity": "m/s",
    "gas_velocity": "m/s",
    "drag_coefficient": "kg/m³/s",
    "drag_correction": "-",
    "solids_pressure": "Pa",
    "filtered_slip": "m/s",
    "filtered_drag": "Pa/m",
    "shear_rate": "1/s",
}


def image_of(path):
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(path)
    reader.Update()
    assert reader.GetErrorCode() == 0, path
    return reader.GetOutput()


def arrays_of(data):
    return {data.GetArrayName(n): vtk_to_numpy(data.GetArray(n)) for n in range(data.GetNumberOfArrays())}


def check_units(data, expected):
    for name, unit in expected.items():
        array = data.GetArray(name)
        if array is not None:
            found = array.GetInformation().Get(vtk.vtkDataArray.UNITS_LABEL())
            assert found == unit, (name, found)


def series(path):
    """Times and images of a .pvd, and the same by PyVista."""
    reader = pyvista.get_reader(path)
    listed = xml.parse(path).getroot().iter("DataSet")
    listed = [(float(d.get("timestep")), d.get("file")) for d in listed]
    assert [t for t, _ in listed] == list(reader.time_values) and len(listed) > 3
    for n, (time, file) in enumerate(listed):
        image = image_of(os.path.join(os.path.dirname(path), file))
        assert image.GetFieldData().GetArray("TimeValue").GetValue(0) == time
        check_units(image.GetCellData(), UNITS)
        reader.set_active_time_point(n)
        block = reader.read()[0]
        for name, values in arrays_of(image.GetCellData()).items():
            np.testing.assert_array_equal(block.cell_data[name], values)
        yield time, image


def check_hdf(path, images):
    """That the file holds `images`, (time, image) each, by VTK and by h5py."""
    reader = vtk.vtkHDFReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    information = reader.GetOutputInformation(0)
    key = vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    times = [information.Get(key, n) for n in range(information.Length(key))]
    assert times == [time for time, _ in images]
    assert reader.GetNumberOfSteps() == len(images)
    with h5py.File(path) as file:
        group = file["VTKHDF"]
        assert group.attrs["Type"] == b"ImageData" and list(group["Steps/Values"]) == times
        assert group["Steps/Values"].attrs["units"] == b"s"
        for step, (_, image) in enumerate(images):
            reader.SetStep(step)
            reader.Update()
            found = reader.GetOutput()
            assert found.GetDimensions() == image.GetDimensions()
            assert found.GetSpacing() == image.GetSpacing() and found.GetOrigin() == image.GetOrigin()
            assert found.GetNumberOfCells() == image.GetNumberOfCells()
            arrays = arrays_of(image.GetCellData())
            hdf = arrays_of(found.GetCellData())
            assert set(hdf) == set(arrays) == set(group["CellData"]), set(hdf) ^ set(arrays)
            shape = tuple(n - 1 for n in image.GetDimensions()[::-1] if n > 1)
            for name, values in arrays.items():
                np.testing.assert_array_equal(hdf[name], values)
                dataset = group["CellData"][name]
                np.testing.assert_array_equal(dataset[step], values.reshape(shape + values.shape[1:]))
                unit = image.GetCellData().GetArray(name).GetInformation().Get(vtk.vtkDataArray.UNITS_LABEL())
                assert dataset.attrs["units"].decode() == unit
                assert dataset.compression == "gzip"


def fields():
    resolved = list(series("flight/fields_0.15.pvd"))
    check_hdf("vtkhdf/resolved.vtkhdf", resolved)
    flat = resolved[0][1].GetDimensions()[2] == 1
    axes = 2 if flat else 3
    size = [0.04, 0.06] if flat else [0.02, 0.025, 0.03]
    seen = 0
    for path in sorted(glob.glob("vti/filtered_*.pvd")):
        width = float(path[len("vti/filtered_"):-len(".pvd")])
        filtered = list(series(path))
        check_hdf(path.replace("vti/", "vtkhdf/").replace(".pvd", ".vtkhdf"), filtered)
        assert [time for time, _ in filtered] == [time for time, _ in resolved]
        for (_, fine), (_, coarse) in zip(resolved, filtered):
            fields, found = arrays_of(fine.GetCellData()), arrays_of(coarse.GetCellData())
            h, step = np.array(fine.GetSpacing()), np.array(coarse.GetSpacing())
            shape = [n - 1 for n in fine.GetDimensions()[:axes]]
            count = [n - 1 for n in coarse.GetDimensions()[:axes]]
            np.testing.assert_allclose((step * 1)[:axes] * count, size)
            cells = [round(width / h[a]) for a in range(axes)]

            def filt(values):
                values = values.reshape(shape[::-1], order="C").T
                for axis in range(axes):
                    centre = coarse.GetOrigin()[axis] + 0.5 * step[axis]
                    first = round(centre / h[axis] - 0.5 * cells[axis])
                    assert abs(first - (centre / h[axis] - 0.5 * cells[axis])) < 1e-9
                    stride = round(step[axis] / h[axis])
                    rolled = sum(np.roll(values, -k - first, axis) for k in range(cells[axis]))
                    values = np.take(rolled, range(0, shape[axis], stride), axis) / cells[axis]
                return values.T.ravel()

            phi, us, ug = (fields[n] for n in ("solids_fraction", "solids_velocity", "gas_velocity"))
            mean = filt(phi)
            close = lambda name, expected: np.testing.assert_allclose(
                found[name], expected, rtol=1e-10, atol=1e-12 * (1 + np.abs(expected).max()), err_msg=name)
            close("solids_fraction", mean)
            for axis in range(axes):
                solids = filt(phi * us[:, axis]) / mean
                gas = filt((1 - phi) * ug[:, axis]) / (1 - mean)
                np.testing.assert_allclose(found["solids_velocity"][:, axis], solids, atol=1e-9)
                np.testing.assert_allclose(found["gas_velocity"][:, axis], gas, atol=1e-9)
                np.testing.assert_allclose(found["filtered_slip"][:, axis], gas - solids, atol=1e-9)
            close("solids_fraction_variance", filt(phi * phi) - mean * mean)
            z = axes - 1
            drag = filt(fields["drag_coefficient"] * (ug[:, z] - us[:, z]))
            gradient = fields["pressure_gradient"][:, z]
            close("drag_no_pressure", drag)
            close("drag", drag - (filt(phi * gradient) - mean * filt(gradient)))
            # H has one more number in it, the law's coefficient, that H without pressure shares.
            ratio = (1 - found["drag_correction"]) / (1 - found["drag_correction_no_pressure"])
            np.testing.assert_allclose(ratio, found["drag"] / found["drag_no_pressure"], rtol=1e-8)
            if flat:
                assert not found["solids_velocity"][:, 2].any()
            seen += 1
    assert seen > 3


def particles():
    reader = pyvista.get_reader("particles.pvd")
    assert list(reader.time_values) == [0.0, 0.25, 0.5]
    for instant in range(3):
        time = 0.25 * instant
        xml_reader = vtk.vtkXMLPolyDataReader()
        xml_reader.SetFileName(f"particles_{instant}.vtp")
        xml_reader.Update()
        assert xml_reader.GetErrorCode() == 0
        data = xml_reader.GetOutput()
        reader.set_active_time_point(instant)
        count = data.GetNumberOfPoints()
        assert count == data.GetNumberOfVerts() == 40000
        expected = lambda k: k + np.arange(count) / 8 + time
        vector = lambda k: np.stack([expected(k + a) for a in range(3)], 1)
        for points, array in (
            (vtk_to_numpy(data.GetPoints().GetData()), arrays_of(data.GetPointData())),
            (lambda mesh: (mesh.points, mesh.point_data))(reader.read()[0]),
        ):
            np.testing.assert_array_equal(points, vector(0))
            np.testing.assert_array_equal(array["velocity"], vector(3))
            np.testing.assert_array_equal(array["spin"], vector(6))
            np.testing.assert_array_equal(array["diameter"], expected(9))
            np.testing.assert_array_equal(array["id"], count - np.arange(count))
        assert data.GetFieldData().GetArray("TimeValue").GetValue(0) == time
        units = {"velocity": "m/s", "spin": "rad/s", "diameter": "m", "id": "-"}
        check_units(data.GetPointData(), units)
        verts = vtk_to_numpy(data.GetVerts().GetConnectivityArray())
        np.testing.assert_array_equal(verts, np.arange(count))


globals()[sys.argv[1]]()
