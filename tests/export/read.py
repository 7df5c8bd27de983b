"""Prints a point of the tables of a quantity of three markers, and the value in each file."""
import csv
import sys

import numpy
import vtk

name = sys.argv[1]
arrays = numpy.load(name + ".npz")
axes = [arrays[marker] for marker in ("solids_fraction", "filter_width", "slip")]
i, j, k = 20, 11, 25
value = arrays[name][i, j, k]

with open(name + ".csv") as file:
    rows = list(csv.reader(file))
row = rows[1 + (i * len(axes[1]) + j) * len(axes[2]) + k]

reader = vtk.vtkXMLImageDataReader()
reader.SetFileName(name + ".vti")
reader.Update()
image = reader.GetOutput()
point = image.FindPoint([float(axis[n]) for axis, n in zip(axes, (i, j, k))])
print(*(float(axis[n]) for axis, n in zip(axes, (i, j, k))), value, row[3],
      *image.GetPoint(point), image.GetPointData().GetArray(name).GetValue(point))
