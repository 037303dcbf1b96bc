import contextlib
import os
import pickle
import sys
import types
import zipfile

import numpy as np
import pytest
from scipy import sparse

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers import foreign_arrays
from deblur_avatar.readers.foreign_arrays import (
    Record,
    load_arrays,
    load_npy,
    load_npy_files,
    load_npz,
)


class _Command:
    """Pickles as a call of `os.system`."""

    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        import os

        return os.system, (self.command,)


@pytest.fixture
def chumpy(monkeypatch):
    """A module of chumpy's name whose classes pickle as chumpy's do."""
    modules = {
        name: types.ModuleType(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")
    }
    for module, names in (("chumpy.ch", ["Ch"]), ("chumpy.reordering", ["Select", "transpose"])):
        for name in names:
            kind = type(name, (), {"__module__": module})
            setattr(modules[module], name, kind)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    yield modules
    for name in modules:
        assert name in sys.modules


def _instance(kind, **state):
    made = kind()
    made.__dict__.update(state)
    return made


def _write(path, content, protocol=2):
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    return path


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_numbers_and_words_come_back_from_every_protocol(tmp_path, protocol):
    content = {
        "floats": np.arange(6.0).reshape(2, 3), "fortran": np.asfortranarray(np.eye(3)[:, :2]),
        "integers": np.array([1, 2], np.uint32), "one": np.float32(1.5), "name": "SMPL",
        "flags": {"a", "b"}, "empty": np.zeros((0, 3)), "words": np.array(["x", None], object),
    }  # fmt: skip
    read = load_arrays(_write(tmp_path / "file.pkl", content, protocol))
    assert read.keys() == content.keys()
    for key in ("floats", "fortran", "integers", "one", "empty"):
        np.testing.assert_array_equal(read[key], content[key])
        assert read[key].dtype == content[key].dtype
    assert read["name"] == "SMPL"
    assert read["flags"] == {"a", "b"}
    assert list(read["words"]) == ["x", None]


def test_bytes_of_python_2_are_read_as_its_numbers(tmp_path):
    # What Python 2.7 with numpy 1.x wrote for {'a': numpy.array([1., 2.]), 'b': numpy.float64(3)}.
    text = (
        b"\x80\x02}q\x00(U\x01aq\x01cnumpy.core.multiarray\n_reconstruct\nq\x02cnumpy\nndarray\n"
        b"q\x03K\x00\x85U\x01b\x87Rq\x04(K\x01K\x02\x85cnumpy\ndtype\nq\x05U\x02f8K\x00K\x01\x87R"
        b"q\x06(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x10"
        + np.array([1.0, 2.0]).tobytes()
        + b"tbU\x01bcnumpy.core.multiarray\nscalar\nh\x06U\x08"
        + np.float64(3.0).tobytes()
        + b"\x86Ru."
    )
    path = tmp_path / "file.pkl"
    path.write_bytes(text)
    read = load_arrays(path)
    np.testing.assert_array_equal(read["a"], [1.0, 2.0])
    assert read["b"] == 3.0


@pytest.mark.parametrize("kind", ["csc", "csr"])
@pytest.mark.parametrize("flavour", ["matrix", "array"])
def test_sparse_matrices_come_as_dense_arrays(tmp_path, kind, flavour):
    dense = np.array([[0, 2.0, 0], [1, 0, 3]])
    made = getattr(sparse, f"{kind}_{flavour}")(dense)
    path = _write(tmp_path / "file.pkl", {"regressor": made})
    read = load_arrays(path)["regressor"]
    assert isinstance(read, np.ndarray)
    np.testing.assert_array_equal(read, dense)


def test_sparse_indices_out_of_range_are_refused(tmp_path):
    matrix = sparse.csc_matrix(np.eye(3))
    matrix.indices[0] = 1_000_000
    path = _write(tmp_path / "file.pkl", {"regressor": matrix})
    with pytest.raises(ArtifactError, match="regressor: a damaged scipy.csc_matrix"):
        load_arrays(path)


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_chumpy_arrays_are_read_without_chumpy(tmp_path, chumpy, protocol):
    values = np.arange(12.0).reshape(2, 6)
    leaf = _instance(chumpy["chumpy.ch"].Ch, x=values, _dirty_vars=set())
    part = _instance(
        chumpy["chumpy.reordering"].Select,
        a=leaf, idxs=np.array([11, 0, 5, 7]), preferred_shape=(2, 2),
    )  # fmt: skip
    other = _instance(chumpy["chumpy.reordering"].transpose, a=leaf)
    path = _write(tmp_path / "file.pkl", {"leaf": leaf, "part": part, "other": other}, protocol)
    for name in chumpy:
        sys.modules[name] = None  # so that importing it would fail
    read = load_arrays(path)
    np.testing.assert_array_equal(read["leaf"], values)
    np.testing.assert_array_equal(read["part"], [[11.0, 0.0], [5.0, 7.0]])
    assert isinstance(read["other"], Record)
    assert read["other"].name == "chumpy.transpose"


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_file_that_calls_a_program_is_refused_and_nothing_runs(tmp_path, protocol):
    trace = tmp_path / "trace"
    content = {"v_template": np.zeros(3), "x": _Command(f"touch {trace}")}
    path = _write(tmp_path / "file.pkl", content, protocol)
    with pytest.raises(ArtifactError, match=r"wants to run (posix|nt|os)\.system"):
        load_arrays(path)
    assert not trace.exists()
    pickle.loads(path.read_bytes())  # the file would have done it
    assert trace.exists()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (b"cbuiltins\neval\n(S'1'\ntR.", "builtins.eval"),
        (b"cbuiltins\ngetattr\n.", "builtins.getattr"),
        (b"cnumpy\nload\n.", "numpy.load"),
        (b"cscipy.sparse\nload_npz\n.", "scipy.sparse.load_npz"),
        (b"cdeblur_avatar.pickles\n_ADMITTED\n.", "_ADMITTED"),
        (b"c_codecs\nencode\n(S'a'\nS'rot13'\ntR.", "an encoding 'rot13'"),
        (b"ccopy_reg\n_reconstructor\n(cnumpy\ndtype\nc__builtin__\nobject\nNtR.", "constructor"),
        (b"cbuiltins\nbytes\n(I9999999999\ntR.", "bytes of 9999999999"),
        (b"Pkey\n.", "a persistent object 'key'"),
        (b"\x80\x04\x8c\x05numpy\x8c\x0bndarray.ctx\x93.", "numpy.ndarray.ctx"),
    ],
)
def test_names_outside_the_list_are_refused_by_name(tmp_path, text, named):
    path = tmp_path / "file.pkl"
    path.write_bytes(text)
    with pytest.raises(ArtifactError, match="nothing was executed") as refusal:
        load_arrays(path)
    assert named in str(refusal.value)


def test_a_missing_damaged_or_foreign_file_is_one_clear_error(tmp_path):
    with pytest.raises(ArtifactError, match="cannot read .*absent.pkl: No such file"):
        load_arrays(tmp_path / "absent.pkl")
    whole = pickle.dumps({"a": np.arange(100.0)}, protocol=2)
    damaged = tmp_path / "damaged.pkl"
    for length in (0, 1, 20, len(whole) // 2, len(whole) - 1):
        damaged.write_bytes(whole[:length])
        with pytest.raises(ArtifactError, match=r"not a readable \.pkl file"):
            load_arrays(damaged)
    with pytest.raises(ArtifactError, match="holds a list, wanted a dictionary"):
        load_arrays(_write(tmp_path / "list.pkl", [1, 2]))


def test_a_chumpy_array_without_content_is_damage(tmp_path, chumpy):
    path = _write(tmp_path / "file.pkl", {"shapedirs": _instance(chumpy["chumpy.ch"].Ch, y=1)})
    with pytest.raises(ArtifactError, match="shapedirs: a damaged chumpy.Ch"):
        load_arrays(path)


def test_an_array_class_of_a_file_allocates_nothing(tmp_path):
    path = tmp_path / "file.pkl"
    path.write_bytes(b"cnumpy\nndarray\n((I99999999999\ntt" + b"R.")
    with pytest.raises(ArtifactError, match=r"not a readable \.pkl file"):
        load_arrays(path)


@pytest.fixture
def brief(monkeypatch):
    """A reader that gives up early."""
    monkeypatch.setattr(foreign_arrays, "MAX_SECONDS", 1)
    monkeypatch.setattr(foreign_arrays, "MAX_MEMORY", 1 << 29)


def read_or_refused(path):
    """What a hostile file may come to."""
    with contextlib.suppress(ArtifactError):
        return load_arrays(path)
    return None


@pytest.mark.parametrize("text", [b"\x80\x02}r\xff\xff\xff\x7f.", b"(dp999999999\n."])
def test_a_far_index_of_the_memo_fills_no_memory_of_ours(tmp_path, brief, text):
    path = tmp_path / "file.pkl"
    path.write_bytes(text)
    assert not read_or_refused(path)


def _get(index):
    return b"h" + bytes([index])


# Forty containers, each in the next one three times: 500 bytes that stand for 10^19 objects.
_LISTS = b"](K\x01K\x01e\x94" + b"".join(b"](" + 3 * _get(i) + b"e\x94" for i in range(40))
_TUPLES = b"K\x01\x94" + b"".join(3 * _get(i) + b"\x87\x94" for i in range(40))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_TUPLES + b"}" + _get(40) + b"K\x01s.", "took over 1 s or 512 MB"),
        (_TUPLES + b"}(" + _get(40) + b"K\x01u.", "took over 1 s or 512 MB"),
        (_TUPLES + b"(" + _get(40) + b"K\x01d.", "took over 1 s or 512 MB"),
        (_TUPLES + b"\x8f(" + _get(40) + b"\x90.", "took over 1 s or 512 MB"),
        (_TUPLES + b"(" + _get(40) + b"\x91.", "took over 1 s or 512 MB"),
        (b"](" + _TUPLES + b"ecbuiltins\nset\n" + _get(40) + b"\x85R.", "took over 1 s or 512 MB"),
        (_LISTS + b"Q.", "wants to run a persistent object list"),
        (_LISTS + b"0cbuiltins\nbytes\n]\x85R.", "wants to run bytes of list"),
    ],
)
def test_few_bytes_that_unfold_without_end_are_refused(tmp_path, brief, text, message):
    path = tmp_path / "file.pkl"
    path.write_bytes(b"\x80\x04" + text)
    with pytest.raises(ArtifactError, match=message):
        load_arrays(path)


def test_two_files_are_read_by_one_process_and_the_damaged_one_is_named(tmp_path):
    paths = [tmp_path / f"{index}.npy" for index in range(3)]
    for index, path in enumerate(paths):
        np.save(path, {"a": np.full(2, index)})
    assert [int(read["a"][0]) for read in load_npy_files(paths)] == [0, 1, 2]
    paths[1].write_bytes(paths[1].read_bytes()[:-4])
    with pytest.raises(ArtifactError, match=r"1\.npy is not a readable"):
        load_npy_files(paths)


def test_a_file_that_ends_its_reader_is_refused(tmp_path):
    path = tmp_path / "file.pkl"
    path.write_bytes(b"\x80\x04})" + b"\x85" * 3_000_000 + b"K\x01s.")  # hashed on the C stack
    with pytest.raises(ArtifactError, match="or ended the reader"):
        load_arrays(path)


def test_a_pipe_that_never_ends_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_arrays, "MAX_SECONDS", 0.1)
    os.mkfifo(tmp_path / "file.pkl")
    with pytest.raises(ArtifactError, match="is not a readable"):
        load_arrays(tmp_path / "file.pkl")


def test_a_container_that_is_in_others_often_is_no_key_and_may_be(tmp_path):
    shared = list(range(1000))
    content = {"a": [shared] * 50, "b": {(1, 2): [shared] * 50}}
    assert load_arrays(_write(tmp_path / "file.pkl", content))["b"][1, 2][49] == shared


def test_a_sparse_matrix_that_unfolds_to_too_much_is_refused(tmp_path):
    path = _write(tmp_path / "file.pkl", {"regressor": sparse.csc_matrix((2**40, 3))})
    assert path.stat().st_size < 1000
    with pytest.raises(ArtifactError, match="unfolds to too large an array"):
        load_arrays(path)


def test_a_file_over_the_limit_is_not_opened(tmp_path, monkeypatch):
    path = _write(tmp_path / "file.pkl", {"a": np.zeros(1 << 18)})
    monkeypatch.setattr(foreign_arrays, "MAX_BYTES", 1 << 20)
    with pytest.raises(ArtifactError, match="has 2 MB, at most 1 MB are read"):
        load_arrays(path)


def test_npy_files_hold_an_array_or_a_dictionary(tmp_path):
    np.save(tmp_path / "numbers.npy", np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(load_npy(tmp_path / "numbers.npy"), [[0, 1, 2], [3, 4, 5]])
    content = {"cams": {"K": [np.eye(3)]}, "ims": [{"ims": ["a/0.jpg"]}], "one": np.str_("x")}
    np.save(tmp_path / "annots.npy", content)
    read = load_npy(tmp_path / "annots.npy")
    assert read["ims"] == content["ims"]
    assert read["one"] == "x"
    np.testing.assert_array_equal(read["cams"]["K"][0], np.eye(3))


def test_npy_files_run_nothing(tmp_path):
    trace = tmp_path / "trace"
    np.save(tmp_path / "annots.npy", {"x": _Command(f"touch {trace}")})
    with pytest.raises(ArtifactError, match=r"wants to run (posix|nt|os)\.system"):
        load_npy(tmp_path / "annots.npy")
    assert not trace.exists()


def test_damaged_npy_files_are_one_clear_error(tmp_path):
    path = tmp_path / "file.npy"
    np.save(path, np.zeros(9))
    for content in (b"", b"text", path.read_bytes()[:-8]):
        path.write_bytes(content)
        with pytest.raises(ArtifactError, match=r"not a readable \.npy file"):
            load_npy(path)
    np.save(path, np.array([None, 1, "x"], object))
    with pytest.raises(ArtifactError, match="holds a ndarray, wanted a dictionary"):
        load_npy(path)
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**40,)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(ArtifactError, match=r"not a readable \.npy file: needs over"):
        load_npy(path)


def test_wanted_arrays_are_read_and_the_others_left(tmp_path):
    np.savez(tmp_path / "file.npz", a=np.arange(3), b=np.array([None], object))
    read = load_npz(tmp_path / "file.npz", {"a", "c"})
    assert list(read) == ["a"]
    np.testing.assert_array_equal(read["a"], [0, 1, 2])


def test_an_archive_that_unfolds_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign_arrays, "MAX_MEMORY", 1 << 29)
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, poses=np.zeros(1 << 27))
    assert path.stat().st_size < 2_000_000
    with pytest.raises(ArtifactError, match=r"bomb.npz is not .*: needs over 512 MB"):
        load_npz(path, {"poses"})
    assert load_npz(path, {"trans"}) == {}


def test_a_header_that_promises_too_much_is_damage(tmp_path):
    path = tmp_path / "file.npz"
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**60,)}
    with zipfile.ZipFile(path, "w") as archive, archive.open("poses.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        load_npz(path, {"poses"})


def test_pickled_objects_and_damage_are_one_clear_error(tmp_path):
    path = tmp_path / "file.npz"
    np.savez(path, a=np.array([None], object))
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file: .*allow_pickle"):
        load_npz(path, {"a"})
    np.savez(path, a=np.arange(1000))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        load_npz(path, {"a"})
    with pytest.raises(ArtifactError, match="cannot read .*absent.npz: No such file"):
        load_npz(tmp_path / "absent.npz", {"a"})
