"""DICOM series made from a field of the world: value = a x + b y + c z, so that a voxel in a wrong place shows."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate
from pydicom.uid import ExplicitVRLittleEndian, JPEGLSLossless

WEIGHTS = np.array([3.0, -5.0, 7.0])
CT, ENHANCED_CT, SECONDARY = (
    "1.2.840.10008.5.1.4.1.1.2",
    "1.2.840.10008.5.1.4.1.1.2.1",
    "1.2.840.10008.5.1.4.1.1.7",
)


def values_at(points):
    """The field at points (..., 3), mm, LPS, as whole numbers that fit into 16 bits."""
    return np.rint(np.asarray(points) @ WEIGHTS).astype(np.int16)


@dataclass
class Series:
    """Where the slices of a series lie: ``positions`` of the first pixels in the order of the files."""

    rows: int = 5
    columns: int = 7
    spacing: tuple = (0.5, 0.75)  # between rows, between columns
    orientation: tuple = (1, 0, 0, 0, 1, 0)
    positions: list = field(default_factory=list)
    uid: str = "1.2.3.4.5"
    changes: dict = field(default_factory=dict)

    @property
    def normal(self):
        turn = np.array(self.orientation, float)
        return np.cross(turn[:3], turn[3:])

    def stacked(self, count=4, step=2.0, origin=(10.0, -20.0, 30.0)):
        """So many slices along the normal."""
        self.positions = [np.array(origin) + n * step * self.normal for n in range(count)]
        return self

    def points(self, position):
        """The centres of a slice's pixels, (rows, columns, 3)."""
        turn = np.array(self.orientation, float)
        row, column = np.mgrid[: self.rows, : self.columns]
        along_row, along_column = (
            column[..., None] * self.spacing[1],
            row[..., None] * self.spacing[0],
        )
        return np.array(position) + along_row * turn[:3] + along_column * turn[3:]

    def dataset(self, number):
        """The slice of a number."""
        position = self.positions[number]
        one = Dataset()
        one.file_meta = FileMetaDataset()
        one.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        one.SOPClassUID, one.SOPInstanceUID = (
            CT,
            f"{self.uid}.{number + 1}" if self.uid else f"1.9.{number}",
        )
        one.StudyInstanceUID, one.SeriesInstanceUID, one.FrameOfReferenceUID = (
            "1.2.3",
            self.uid,
            "1.2.3.9",
        )
        one.PatientID, one.PatientName, one.Modality, one.SeriesNumber = "P1", "Nobody", "CT", 2
        one.StudyDate, one.StudyTime, one.SeriesDescription = "20200102", "101112", "phantom"
        one.StudyID, one.PatientBirthDate, one.PatientSex, one.AccessionNumber = "1", "", "O", ""
        one.ReferringPhysicianName, one.ImageType = "", ["ORIGINAL", "PRIMARY", "AXIAL"]
        one.Rows, one.Columns, one.InstanceNumber = self.rows, self.columns, number + 1
        one.ImagePositionPatient = [float(part) for part in np.round(position, 9)]
        one.ImageOrientationPatient = [float(part) for part in np.round(self.orientation, 12)]
        one.PixelSpacing, one.SliceThickness = (
            list(self.spacing),
            9.0,
        )  # the thickness is not the distance
        one.SamplesPerPixel, one.PhotometricInterpretation = 1, "MONOCHROME2"
        one.BitsAllocated, one.BitsStored, one.HighBit, one.PixelRepresentation = 16, 16, 15, 1
        one.PixelData = values_at(self.points(position)).tobytes()
        for name, value in self.changes.items():
            setattr(one, name, value)
        return one

    def write(self, folder: Path, names=None):
        """Write all slices; returns their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for number in range(len(self.positions)):
            path = folder / (names[number] if names else f"{number:03d}.dcm")
            save(self.dataset(number), path)
            paths.append(path)
        return paths


def save(dataset, path):
    """Write a dataset, also one that breaks the standard."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path.parent.mkdir(parents=True, exist_ok=True)
        dataset.save_as(path, enforce_file_format=True)


def packed_jpeg_ls(dataset):
    """The same slice in JPEG-LS."""
    import jpeg_ls

    # ITK and pyjpegls agree on values without a sign.
    array = dataset.pixel_array.astype(np.int32) + 32768
    dataset.PixelRepresentation, dataset.RescaleSlope, dataset.RescaleIntercept = 0, 1, -32768
    dataset.PixelData = encapsulate([bytes(jpeg_ls.encode_array(array.astype(np.uint16)))])
    dataset["PixelData"].is_undefined_length = True
    dataset.file_meta.TransferSyntaxUID = JPEGLSLossless
    return dataset


def enhanced(series, slopes=None):
    """All slices as one enhanced file, in the order of ``positions``."""
    count = len(series.positions)
    one = series.dataset(0)
    for name in (
        "ImagePositionPatient",
        "ImageOrientationPatient",
        "PixelSpacing",
        "SliceThickness",
        "InstanceNumber",
    ):
        delattr(one, name)
    one.SOPClassUID, one.NumberOfFrames = ENHANCED_CT, count
    shared, turn, size = Dataset(), Dataset(), Dataset()
    turn.ImageOrientationPatient = [float(part) for part in np.round(series.orientation, 12)]
    size.PixelSpacing, size.SliceThickness = list(series.spacing), 9.0
    shared.PlaneOrientationSequence, shared.PixelMeasuresSequence = [turn], [size]
    one.SharedFunctionalGroupsSequence = [shared]
    frames, pixels = [], []
    for number, position in enumerate(series.positions):
        place, scale, frame, content = Dataset(), Dataset(), Dataset(), Dataset()
        place.ImagePositionPatient = [float(part) for part in np.round(position, 9)]
        content.StackID, content.InStackPositionNumber = "1", number + 1
        frame.PlanePositionSequence, frame.FrameContentSequence = [place], [content]
        stored = values_at(series.points(position)).astype(float)
        if slopes is not None:
            scale.RescaleSlope, scale.RescaleIntercept, scale.RescaleType = slopes[number], -3, "US"
            frame.PixelValueTransformationSequence = [scale]
            stored = (stored + 3) / slopes[number]
        frames.append(frame)
        pixels.append(np.rint(stored).astype(np.int16))
    one.PerFrameFunctionalGroupsSequence = frames
    one.PixelData = np.stack(pixels).tobytes()
    return one


def world_of(volume):
    """The centres of a volume's voxels, (nz, ny, nx, 3)."""
    index = np.stack(np.indices(volume.array.shape), axis=-1).reshape(-1, 3)
    return volume.geometry.index_to_world(index).reshape(*volume.array.shape, 3)


def check(volume, shape=None):
    """Each voxel has the value of its place; a place wrong by 0.01 mm would show in many of them."""
    assert shape is None or volume.array.shape == shape
    assert np.array_equal(np.rint(volume.array), values_at(np.round(world_of(volume), 6)))


assert pydicom
