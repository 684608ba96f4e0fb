# SPDX-License-Identifier: BSD-3-Clause
"""Options of the commands that read data; evaluated by `piezo_recorder.reading.data_options`."""

import argparse

FILE_HELP = ("recording or table of samples (CSV, .mat, .h5, .npz, .tdms, .parquet, .xlsx and "
             "others)")


def add_columns_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--columns``."""
    parser.add_argument(
        "--columns", metavar="WORD", nargs="+",
        help="columns and units of tables of samples, where their labels do not state them: "
        "time=t[ms] voltage=Vpiezo[V] displacement=pos[nm], with a factor as in voltage=CH1[20V]; "
        "rate=10[kHz] without a time; recording=run[2] for one of several; or a YAML file of the "
        "same, which may also lie next to the data as NAME.columns.yaml")
