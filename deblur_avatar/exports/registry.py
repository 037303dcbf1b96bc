"""Registry of exporters: the formats by name."""

from typing import Annotated

from deblur_avatar.config.kinds import KindOf
from deblur_avatar.exports.exporter import Exporter
from deblur_avatar.exports.npz import NpzExport
from deblur_avatar.exports.page.export import PageExport
from deblur_avatar.exports.ply import PlyExport

EXPORTERS: dict[str, type[Exporter]] = {
    "page": PageExport,
    "ply": PlyExport,
    "npz": NpzExport,
}

ExportParams = Annotated[Exporter, KindOf("format", EXPORTERS)]
