"""DICOM slices of a grid, as a scanner would write them, for tests of what refers to them."""

from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataset import FileMetaDataset

from accelsurf.grid.geometry import Geometry
from accelsurf.io.dicom.frames import frames_of
from accelsurf.io.dicom.source_images import SourceImages, read_source_images

CT, ENHANCED_MR = "1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.5.1.4.1.1.4.1"
STUDY, SERIES, FRAME = "1.2.3.4", "1.2.3.4.5", "1.2.3.4.6"


def _texts(numbers):
    return [f"{value:.10g}" for value in numbers]


def _common(geometry: Geometry, sop_class: str, instance: str):
    dataset = pydicom.Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = "1.2.840.10008.1.2.1"
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = sop_class
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID = instance
    dataset.StudyInstanceUID, dataset.SeriesInstanceUID, dataset.FrameOfReferenceUID = (
        STUDY,
        SERIES,
        FRAME,
    )
    dataset.SpecificCharacterSet = "ISO_IR 100"
    dataset.PatientName, dataset.PatientID, dataset.PatientSex = "Müller^Ada", "P1", "F"
    dataset.PatientBirthDate, dataset.StudyDate, dataset.StudyTime = (
        "19500102",
        "20200304",
        "101112",
    )
    dataset.SeriesDate, dataset.SeriesTime = "20200304", "111213.5"
    dataset.AccessionNumber, dataset.StudyID, dataset.ReferringPhysicianName = "A1", "S1", ""
    dataset.Manufacturer, dataset.SeriesNumber, dataset.InstanceNumber = "Scanner", 7, 1
    dataset.Rows, dataset.Columns = geometry.shape[1:]
    dataset.SamplesPerPixel, dataset.PhotometricInterpretation = 1, "MONOCHROME2"
    dataset.BitsAllocated = dataset.BitsStored = 16
    dataset.HighBit, dataset.PixelRepresentation = 15, 1
    return dataset


def write_slices(
    folder: Path, geometry: Geometry, order=None, values=None, **changes
) -> list[Path]:
    """One file a slice, returned in the order of z; ``order`` numbers the files, ``changes`` are values of headers."""
    folder.mkdir(parents=True, exist_ok=True)
    order = range(geometry.shape[0]) if order is None else order
    values = np.zeros(geometry.shape, np.int16) if values is None else values
    paths = []
    for k, number in zip(range(geometry.shape[0]), order, strict=True):
        dataset = _common(geometry, CT, f"{SERIES}.{number + 1}")
        dataset.Modality, dataset.SliceThickness = "CT", "1.25"
        dataset.InstanceNumber = number + 1
        dataset.ImagePositionPatient = _texts(geometry.index_to_world((k, 0, 0)))
        dataset.ImageOrientationPatient = _texts(geometry.direction[:, :2].T.ravel())
        dataset.PixelSpacing = _texts(geometry.spacing[1:])
        dataset.PixelData = np.ascontiguousarray(values[k], "<i2").tobytes()
        for keyword, value in changes.items():
            if value is None:
                delattr(dataset, keyword)
            else:
                setattr(dataset, keyword, value)
        paths.append(folder / f"{number:03}.dcm")
        dataset.save_as(paths[-1], enforce_file_format=True)
    return paths


def write_frames(path: Path, geometry: Geometry, order=None) -> list[Path]:
    """One file of all slices; frame ``order[k]`` (from 0) is slice k."""
    order = range(geometry.shape[0]) if order is None else order
    dataset = _common(geometry, ENHANCED_MR, f"{SERIES}.1")
    dataset.Modality, dataset.NumberOfFrames = "MR", geometry.shape[0]
    shared, groups = pydicom.Dataset(), [pydicom.Dataset() for _ in order]
    measures, orientation = pydicom.Dataset(), pydicom.Dataset()
    measures.PixelSpacing, measures.SliceThickness = _texts(geometry.spacing[1:]), "1.25"
    orientation.ImageOrientationPatient = _texts(geometry.direction[:, :2].T.ravel())
    shared.PixelMeasuresSequence = [measures]
    for k, number in enumerate(order):
        position = pydicom.Dataset()
        position.ImagePositionPatient = _texts(geometry.index_to_world((k, 0, 0)))
        groups[number].PlanePositionSequence = [position]
        # Per frame, as some scanners write it: highdicom alone would refuse that.
        groups[number].PlaneOrientationSequence = [orientation]
    dataset.SharedFunctionalGroupsSequence, dataset.PerFrameFunctionalGroupsSequence = (
        [shared],
        groups,
    )
    dataset.PixelData = np.zeros(geometry.shape, "<i2").tobytes()
    path.parent.mkdir(parents=True, exist_ok=True)
    dataset.save_as(path, enforce_file_format=True)
    return [path]


def source_of(paths) -> SourceImages:
    """What objects refer to, of files in the order of z."""
    return read_source_images([frame for path in paths for frame in frames_of(path)])
