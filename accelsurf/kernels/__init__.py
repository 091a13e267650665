"""Compiled code of the method: flat arrays in, flat arrays out.

Nothing here imports anything but numpy, numba (with llvmlite, which it is built on) and math, and numba is imported
nowhere else: compiled code of clicks, images and pictures lies in folders of their rooms that are called kernels, too,
and is compiled by `_jit.kernel`. A kernel that works on band cells takes ``start, stop`` first, the half-open range of
band slots that it owns: it writes nothing outside its range, so ranges may run in several threads and the bytes do not
depend on how many. Every kernel that `Workers` calls names the stage of a step that it belongs to.

Arguments that many kernels have, with n band cells ("slots"):

=================  ==================================================================================================
start, stop        Range of slots that the call owns; ``first_block, last_block`` the same in blocks of `grid.BLOCK`.
grid, dense, band  `grid.Grid`, `grid.DenseArrays` and `grid.Band`, which also define slot, cell and closest point.
psi, slot          The arrays of ``dense``, (nz * ny * nx,): float32, mm; int32, -1 for voxels that are not in the band.
cells              As in the band, (n,) int64; also with more rows, for cells that may enter.
closest_point      As ``to_closest`` of the band, (n, 3) float32 mm; also with more rows, for cells that may enter.
front              (n,) bool, the slots that count.
on, off            (m,) int32 or int64, the slots that the call is about; then the range is one of these rows.
image              (nz * ny * nx,) float32, in any unit.
velocity           (n, 3) float32, z y x, mm per unit time. ``beta`` (n,): speed along the inward normal.
near               (6,) int64 scratch for `grid.neighbours`. ``w`` (24,) float64: scratch for interpolation weights.
out, sums          Written: (n,) or (n, k) by slot; (blocks, k) float64 by block, to be added in order.
=================  ==================================================================================================
"""
