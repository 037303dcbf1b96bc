"""The benchmark of posed meshes: the same results by both ways, on a closed mesh."""

import torch

from benchmarks.posed_mesh import closed_mesh, functions, measured
from deblur_avatar.avatars.mesh_terms import adjacent_faces, mesh_edges
from deblur_avatar.avatars.surface_projection import vertex_normals
from deblur_avatar.rendering.normal_maps import Places

SMALL = 20, 24


def test_its_mesh_is_closed_wound_outwards_and_as_large_as_said():
    vertices, faces = closed_mesh()
    assert len(faces) == 27720
    vertices, faces = closed_mesh(*SMALL)
    edges = mesh_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2
    assert len(adjacent_faces(faces)) == len(edges)
    outwards = vertices / torch.tensor([0.3, 0.85, 0.2]) ** 2
    assert ((vertex_normals(vertices, faces) * outwards).sum(-1) > 0).all()


def test_kernels_and_twins_give_the_same():
    for name, (kernel, twin, given) in functions(*closed_mesh(*SMALL)).items():
        one, other = kernel(*given), twin(*given)
        one, other = ([value] if torch.is_tensor(value) else value for value in (one, other))
        for fast, slow in zip(one, other, strict=True):
            if isinstance(fast, Places):
                assert (fast.triangle >= 0).any()
                fast, slow = fast.triangle.float(), slow.triangle.float()
                assert (fast != slow).float().mean() < 1e-3, name
            else:
                torch.testing.assert_close(fast, slow, rtol=1e-3, atol=1e-5, msg=name)


def test_every_function_has_a_ratio_of_what_was_measured():
    rows = measured(1, closed_mesh(*SMALL))
    assert rows.keys() == functions(*closed_mesh(*SMALL)).keys()
    for name, row in rows.items():
        sums = {way: sum(row[way].values()) for way in ("kernel", "torch")}
        assert row["torch_over_kernel"] == sums["torch"] / sums["kernel"], name
        assert (row["torch"]["backward_ms"] == 0) == (name == "seen_places")
