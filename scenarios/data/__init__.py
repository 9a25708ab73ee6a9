"""Where data lie that are not part of boresight: shapes, images and kernels of missions."""

from scenarios.data.find import DATA_VARIABLE, data_folder, find_data_file, find_data_folder

__all__ = ["DATA_VARIABLE", "data_folder", "find_data_file", "find_data_folder"]
