# SPDX-License-Identifier: BSD-3-Clause
"""Tables of samples in the files of other programs: text, MATLAB, HDF5, NumPy, TDMS, Parquet."""
