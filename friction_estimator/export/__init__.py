"""What was learned, for a controller or a simulator: one file a format, each with the error that it costs."""

from friction_estimator.export import c99, csv_table, mjcf, parameters, urdf
from friction_estimator.export.formats import FORMATS

__all__ = ["FORMATS", "c99", "csv_table", "mjcf", "parameters", "urdf"]
