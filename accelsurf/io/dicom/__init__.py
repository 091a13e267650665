"""DICOM: the files of a folder or archive, their series, where each slice lies, and its values.

The way of data: `sources` finds files, `frames` reads the header of each slice, `volumes` puts slices together,
`slices` proves that they lie on one grid, `pixels` reads the values.
The package pydicom reads headers and plain values, ITK compressed ones.
"""
