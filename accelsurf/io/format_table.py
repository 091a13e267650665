"""The functions of each format of images; importing this module enters them, and imports none of theirs.

They are apart from the formats' entries, `accelsurf.settings.file_formats`, because settings know no files, and lie
above the modules that they name: a format is imported when a file of it is.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from accelsurf.io.format_functions import FORMAT_FUNCTIONS, FormatFunctions
from accelsurf.settings.reading import ReadOptions

if TYPE_CHECKING:
    from accelsurf.io.sequences.sources import FileSequence


def _packed_frames(path: Path, options: ReadOptions, memory_bytes: int | None) -> FileSequence:
    from accelsurf.io.sequences.packed import PackedFrames

    return PackedFrames(path, options, memory_bytes)


def _dicom_frames(path: Path, options: ReadOptions, memory_bytes: int | None) -> FileSequence:
    from accelsurf.io.sequences.sources import DicomFrames

    return DicomFrames(path, options, memory_bytes)


def _nifti_pair() -> FormatFunctions:
    from accelsurf.io.formats import nifti, raw_header

    return FormatFunctions(
        nifti.read_pair_header,
        raw_header.read_raw,
        read_channels=raw_header.read_raw_channels,
        sequence=_packed_frames,
        is_file=nifti.is_of_pair,
    )


def _nifti() -> FormatFunctions:
    from accelsurf.io.formats import nifti, nifti_volumes, raw_header
    from accelsurf.io.sequences.nifti_frames import write_frames

    return replace(
        _nifti_pair(),
        parse=nifti.read_header,
        write=nifti_volumes.write_nifti,
        open=raw_header.open_raw,
        store=nifti_volumes.store_nifti,
        write_frames=write_frames,
        is_file=None,
    )


def _compressed_nifti() -> FormatFunctions:
    from accelsurf.io.formats import nifti, nifti_volumes

    return replace(
        _nifti(),
        parse=nifti.read_header,
        write=nifti_volumes.write_nifti,
        open=None,
        store=None,
    )


def _nrrd() -> FormatFunctions:
    from accelsurf.io.formats import nrrd, raw_header

    return FormatFunctions(
        nrrd.parse_nrrd,
        raw_header.read_raw,
        nrrd.write_nrrd,
        raw_header.read_raw_channels,
        open=raw_header.open_raw,
        sequence=_packed_frames,
    )


def _detached_nrrd() -> FormatFunctions:
    return replace(_nrrd(), write=None)


def _metaimage() -> FormatFunctions:
    from accelsurf.io.formats import metaimage, raw_header

    return FormatFunctions(
        metaimage.parse_metaimage,
        raw_header.read_raw,
        metaimage.write_metaimage,
        raw_header.read_raw_channels,
        open=raw_header.open_raw,
        sequence=_packed_frames,
    )


def _ome_zarr() -> FormatFunctions:
    from accelsurf.io.formats import ome_zarr
    from accelsurf.io.sequences.ome_zarr_frames import write_ome_zarr_frames

    return FormatFunctions(
        ome_zarr.parse_ome_zarr,
        ome_zarr.read_ome_zarr,
        ome_zarr.write_ome_zarr,
        ome_zarr.read_ome_zarr_channels,
        write_labels=ome_zarr.write_labels,
        open=ome_zarr.open_ome_zarr,
        store=ome_zarr.store_ome_zarr,
        write_frames=write_ome_zarr_frames,
    )


def _png() -> FormatFunctions:
    from accelsurf.io.formats import png

    return FormatFunctions(png.parse_png, png.read_png, png.write_png)


def _tiff() -> FormatFunctions:
    from accelsurf.io.formats import tiff, tiff_file
    from accelsurf.io.sequences.tiff_frames import write_tiff_frames

    return FormatFunctions(
        tiff.parse_tiff,
        tiff.read_tiff,
        tiff_file.write_tiff,
        tiff.read_tiff_channels,
        open=tiff.open_tiff,
        write_frames=write_tiff_frames,
    )


def _dicom() -> FormatFunctions:
    from accelsurf.io.formats import dicom

    return FormatFunctions(
        dicom.parse_dicom,
        dicom.read_dicom,
        read_labels=dicom.read_labels,
        sequence=_dicom_frames,
        is_folder=dicom.holds_dicom,
        is_file=dicom.is_dicom,
        listing=dicom.listing,
    )


def _mgh() -> FormatFunctions:
    from accelsurf.io.formats import mgh, raw_header

    return FormatFunctions(mgh.parse_mgh, raw_header.read_raw)


def _slices() -> FormatFunctions:
    from accelsurf.io.formats import slices

    return FormatFunctions(
        slices.parse_slices, slices.read_slices, open=slices.open_slices, is_folder=slices.is_slices
    )


def _npy() -> FormatFunctions:
    from accelsurf.io.formats import numpy_arrays, raw_header

    return FormatFunctions(
        numpy_arrays.parse_npy,
        raw_header.read_raw,
        numpy_arrays.write_npy,
        open=raw_header.open_raw,
    )


FORMAT_FUNCTIONS.update(
    {
        "nii.gz": _compressed_nifti,
        "nii": _nifti,
        "hdr": _nifti_pair,
        "nrrd": _nrrd,
        "nhdr": _detached_nrrd,
        "mha": _metaimage,
        "mhd": _metaimage,
        "ome.zarr": _ome_zarr,
        "png": _png,
        "tif": _tiff,
        "dcm": _dicom,
        "mgz": _mgh,
        "slices": _slices,
        "npy": _npy,
    }
)
