"""DICOM: what accelsurf knows of it beyond the registry entry in `accelsurf.io.formats`."""
