"""Registry of exporters: the formats by name."""

from typing import Annotated

from deblur_avatar.config.kinds import KindOf
from deblur_avatar.exports.bvh import BvhExport
from deblur_avatar.exports.compressed_splats import SogExport, SpzExport
from deblur_avatar.exports.exporter import Exporter
from deblur_avatar.exports.gltf_rig import GltfRigExport
from deblur_avatar.exports.gltf_splats import GltfSplatsExport
from deblur_avatar.exports.npz import NpzExport
from deblur_avatar.exports.page.export import PageExport
from deblur_avatar.exports.ply import PlyExport, PlySequenceExport
from deblur_avatar.exports.rig_arrays import RigArraysExport
from deblur_avatar.exports.usd import UsdExport

EXPORTERS: dict[str, type[Exporter]] = {
    "page": PageExport,
    "ply": PlyExport,
    "ply_sequence": PlySequenceExport,
    "spz": SpzExport,
    "sog": SogExport,
    "gltf_rig": GltfRigExport,
    "gltf_splats": GltfSplatsExport,
    "bvh": BvhExport,
    "npz": NpzExport,
    "rig_arrays": RigArraysExport,
    "usd": UsdExport,
}

ExportParams = Annotated[Exporter, KindOf("format", EXPORTERS)]
