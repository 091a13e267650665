"""All compiled code of accelsurf: flat arrays in, flat arrays out.

Nothing here imports anything but numpy, numba (with llvmlite, which it is built on) and math, and numba is imported
nowhere else. A kernel that works on band cells takes ``start, stop`` first, the half-open range of band slots that it
owns: it writes nothing outside its range, so ranges may run in several threads and the bytes do not depend on how
many. Every kernel that the package calls names the stage of a step that it belongs to.
"""
