"""The kernel of posed meshes beside its slow twins, which other tests hold to what they mean."""

import math

import pytest
import torch

from deblur_avatar.avatars import mesh_gaussians, mesh_normals, mesh_terms, triangle_mesh
from deblur_avatar.avatars.mesh_gaussians import face_gaussians
from deblur_avatar.avatars.mesh_normals import posed_normals
from deblur_avatar.avatars.mesh_terms import (
    adjacent_faces,
    laplacian,
    mesh_edges,
    normal_consistency,
)
from deblur_avatar.avatars.triangle_mesh import corner_lists, neighbour_lists
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads
from tests.randomness import seeded

pytestmark = pytest.mark.portable

THICKNESS = 1e-3
OPEN = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 4], [5, 1, 0]])  # and nobody has vertex 6


def of(body, name):
    """A function of vertices and shapes, by its name."""
    faces = body.faces
    edges, pairs = mesh_edges(faces), adjacent_faces(faces)
    return {
        "gaussians": lambda v, s: face_gaussians(v, faces, s, THICKNESS),
        "normals": lambda v, s: (posed_normals(v, faces),),
        "laplacian": lambda v, s: (laplacian(v, edges),),
        "folds": lambda v, s: (normal_consistency(v, faces, pairs),),
    }[name]


NAMES = pytest.mark.parametrize("name", ["gaussians", "normals", "laplacian", "folds"])


def crumpled(body, instants=3):
    """The body at several instants, each crumpled in another way, and shapes of its Gaussians."""
    noise = torch.randn(instants, *body.vertices.shape, generator=seeded(), dtype=torch.float64)
    shapes = torch.randn(len(body.faces), 3, 3, generator=seeded(1), dtype=torch.float64)
    return body.vertices.double() + 5e-3 * noise, torch.eye(3).double() + 0.3 * shapes


def with_gradients(function, vertices, shapes):
    vertices, shapes = vertices.clone().requires_grad_(), shapes.clone().requires_grad_()
    found = function(vertices, shapes)
    loud = [torch.randn(one.shape, generator=seeded(2), dtype=torch.float64) for one in found]
    total = sum((one * weight.to(one)).sum() for one, weight in zip(found, loud, strict=True))
    grads = torch.autograd.grad(total, (vertices, shapes), allow_unused=True)
    return [one.detach() for one in found] + [grad for grad in grads if grad is not None]


@NAMES
def test_the_kernel_agrees_with_its_slow_twin_in_values_and_gradients(body, name):
    vertices, shapes = crumpled(body)
    function = of(body, name)
    exact = with_gradients(function, vertices, shapes)  # double precision is the twin's
    native = with_gradients(function, vertices.float(), shapes.float())
    assert len(native) == len(exact)
    for fast, slow in zip(native, exact, strict=True):
        assert fast.dtype == torch.float32
        assert fast.shape == slow.shape
        assert slow.any()
        torch.testing.assert_close(
            fast.double(), slow, rtol=1e-3, atol=1e-4 * slow.abs().max().item()
        )


@NAMES
def test_it_is_the_kernel_that_float32_tensors_go_through(body, name, monkeypatch):
    twins = {
        "gaussians": (mesh_gaussians, "face_gaussians_reference"),
        "normals": (mesh_normals, "vertex_normals"),
        "laplacian": (mesh_terms, "laplacian_reference"),
        "folds": (mesh_terms, "normal_consistency_reference"),
    }
    monkeypatch.setattr(*twins[name], None)
    vertices, shapes = crumpled(body)
    of(body, name)(vertices.float(), shapes.float())
    with pytest.raises(TypeError):
        of(body, name)(vertices, shapes)


@NAMES
def test_the_number_of_threads_changes_no_bit(body, name):
    vertices, shapes = (value.float() for value in crumpled(body))
    results = by_threads(lambda: with_gradients(of(body, name), vertices, shapes), 1, 2, 3)
    for values in zip(*results, strict=True):
        assert torch.equal(values[0], values[1])
        assert torch.equal(values[0], values[2])


@NAMES
def test_tensors_need_not_be_contiguous(body, name):
    vertices, shapes = (value.float() for value in crumpled(body))
    strided = [value.permute(0, 2, 1).contiguous().permute(0, 2, 1) for value in (vertices, shapes)]
    assert not strided[0].is_contiguous()
    whole = with_gradients(of(body, name), vertices, shapes)
    for one, other in zip(with_gradients(of(body, name), *strided), whole, strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("name", ["laplacian", "folds"])
def test_without_a_gradient_a_term_is_the_same(body, name):
    vertices, shapes = (value.float() for value in crumpled(body))
    with torch.no_grad():
        (alone,) = of(body, name)(vertices, shapes)
    assert torch.equal(alone, with_gradients(of(body, name), vertices, shapes)[0])


@NAMES
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_not_hidden(body, name, value):
    vertices, shapes = (one.float() for one in crumpled(body))
    vertices[1, int(body.faces[5, 1]), 2] = value
    found = of(body, name)(vertices, shapes)
    assert not all(torch.isfinite(one).all() for one in found)


def test_a_vertex_without_faces_has_no_normal_and_pulls_at_nothing():
    vertices = torch.randn(2, 7, 3, generator=seeded()).requires_grad_()
    normals = posed_normals(vertices, OPEN)
    assert not normals[:, 6].any()
    torch.testing.assert_close(normals[:, :6].norm(dim=-1), torch.ones(2, 6))
    (normals.sum() + laplacian(vertices, mesh_edges(OPEN))).backward()
    assert not vertices.grad[:, 6].any()
    assert vertices.grad[:, :6].any(-1).all()


def test_faces_in_one_place_have_finite_normals_and_gradients():
    flat = torch.zeros(1, 7, 3, requires_grad=True)
    normals = posed_normals(flat, OPEN)
    normals.sum().backward()
    assert not normals.any()
    assert not flat.grad.any()


def test_lists_are_what_each_one_has():
    starts, items = corner_lists(OPEN, 7)
    rows = [items[a:b].tolist() for a, b in zip(starts[:-1], starts[1:], strict=True)]
    assert rows == [[0, 3, 6, 11], [1, 10], [2, 4], [5, 7], [8], [9], []]
    pairs = torch.tensor([[0, 1], [1, 2], [3, 1]])
    starts, items = neighbour_lists(pairs, 5)
    rows = [items[a:b].tolist() for a, b in zip(starts[:-1], starts[1:], strict=True)]
    assert [sorted(row) for row in rows] == [[1], [0, 2, 3], [1], [1], []]


def test_lists_are_found_once_and_anew_for_other_faces_or_another_number_of_rows():
    faces = OPEN.clone()
    first = corner_lists(faces, 7)
    assert corner_lists(faces, 7) is first
    assert len(corner_lists(faces, 9).starts) == 10
    assert corner_lists(faces, 7).items.tolist() == first.items.tolist()
    faces[3] = torch.tensor([5, 6, 0])
    assert corner_lists(faces, 7).items.tolist() != first.items.tolist()


@pytest.mark.parametrize("wrong", [-1, 7, 1 << 40])
def test_a_vertex_that_there_is_not_is_refused(wrong):
    faces = OPEN.clone()
    faces[1, 1] = wrong
    vertices = torch.randn(1, 7, 3, generator=seeded())
    for call in (
        lambda: face_gaussians(vertices, faces, torch.eye(3).expand(4, 3, 3), THICKNESS),
        lambda: posed_normals(vertices, faces),
        lambda: normal_consistency(vertices, faces, torch.tensor([[0, 1]])),
        lambda: laplacian(vertices, torch.tensor([[0, wrong]])),
        lambda: normal_consistency(vertices, OPEN, torch.tensor([[0, wrong]])),
    ):
        with pytest.raises(IndexError, match="has no row"):
            call()


def test_without_a_compiler_it_goes_on_in_plain_torch(monkeypatch):
    check_a_warning_without_a_compiler(triangle_mesh, monkeypatch)
