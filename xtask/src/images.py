"""`glisson import`, `mesh` and `check` against SimpleITK, nibabel, pydicom and meshio.

Arguments: the program, a folder to work in, and CGAL's liver.inr.gz where it is there.
"""
import itertools, json, os, subprocess, sys, warnings
import meshio, nibabel, numpy as np, pydicom, SimpleITK as sitk
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

warnings.filterwarnings("ignore")
program, folder = sys.argv[1], sys.argv[2]
os.makedirs(folder, exist_ok=True)
random = np.random.default_rng(27)


def glisson(*arguments, fails=False):
    run = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    assert (run.returncode == 1) if fails else (run.returncode == 0), (arguments, run.returncode, run.stderr)
    return run.stderr if fails else run.stdout


def path(name):
    return os.path.join(folder, name)


def same_place(what, a, b, tolerance_mm):
    """Two SimpleITK images have their corners at the same places."""
    assert a.GetSize() == b.GetSize(), (what, a.GetSize(), b.GetSize())
    for corner in itertools.product(*[(0, n - 1) for n in a.GetSize()]):
        far = np.abs(np.subtract(a.TransformIndexToPhysicalPoint(corner), b.TransformIndexToPhysicalPoint(corner))).max()
        assert far <= tolerance_mm, (what, corner, far)


def sample(kind):
    """An image with oblique axes, of 7 x 6 x 5 voxels."""
    numbers = random.integers(-1000, 1500, (5, 6, 7)).astype("int16") if kind == "values" else random.integers(0, 4, (5, 6, 7)).astype("uint16")
    image = sitk.GetImageFromArray(numbers)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    image.SetDirection((turn * np.sign(np.linalg.det(turn))).ravel().tolist())
    image.SetSpacing((0.703125, 0.8, 2.5))
    image.SetOrigin((-123.4, 45.6, -789.0))
    return image


# Files of SimpleITK, through glisson, to SimpleITK and nibabel: values, labels and places.
n_trips = 0
for kind, source, target in itertools.product(["values", "labels"], [".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd"], [".nii", ".nii.gz", ".nrrd", ".seg.nrrd", ".mha"]):
    image = sample(kind)
    # ITK takes `b.nii` for `b.nii.gz` where both are there: each trip has names of its own.
    source_file, target_file = path(f"a{n_trips}{source}"), path(f"b{n_trips}{target}")
    sitk.WriteImage(image, source_file, useCompression=source == ".mha")
    glisson("import", source_file, "--labels", str(kind == "labels").lower(), "-o", target_file)
    back = sitk.ReadImage(target_file)
    assert (sitk.GetArrayFromImage(back) == sitk.GetArrayFromImage(image)).all(), (kind, source, target)
    same_place((kind, source, target), back, image, 1e-4 if ".nii" in source + target else 1e-9)
    if ".nii" in target:
        seen = nibabel.load(target_file)
        assert (np.asarray(seen.dataobj).transpose(2, 1, 0) == sitk.GetArrayFromImage(image)).all()
        place = seen.affine @ [3, 2, 1, 1]
        far = np.abs(place[:3] * [-1, -1, 1] - image.TransformIndexToPhysicalPoint((3, 2, 1))).max()
        assert far < 1e-4, far
    n_trips += 1
print(f"{n_trips} trips from SimpleITK through glisson to SimpleITK and nibabel")

# Names and colours of segments, as 3D Slicer keeps them.
image = sample("labels")
for n, (name, colour) in enumerate([("liver", "0.8 0.4 0.2"), ("tumour, left", "1 0 0"), ("gall bladder", "0 0.5 0")]):
    for part, text in [("ID", f"Segment_{n + 1}"), ("Name", name), ("Color", colour), ("LabelValue", str(n + 1)), ("Layer", "0")]:
        image.SetMetaData(f"Segment{n}_{part}", text)
sitk.WriteImage(image, path("s.seg.nrrd"))
for target in [".nii.gz", ".mha", ".nrrd"]:
    glisson("import", path("s.seg.nrrd"), "-o", path("t" + target))
    glisson("import", path("t" + target), "-o", path("u.seg.nrrd"))
    back = sitk.ReadImage(path("u.seg.nrrd"))
    for n in range(3):
        for part in ["Name", "LabelValue"]:
            key = f"Segment{n}_{part}"
            assert back.GetMetaData(key) == image.GetMetaData(key), (target, key)
        colours = [list(map(float, i.GetMetaData(f"Segment{n}_Color").split())) for i in (back, image)]
        assert np.allclose(*colours, atol=1e-6), colours
    assert (sitk.GetArrayFromImage(back) == sitk.GetArrayFromImage(image)).all()
print("names and colours of segments kept by NIfTI, MetaImage and NRRD")

# A DICOM series of pydicom in random order of names.
volume = sample("values")
numbers, turn = sitk.GetArrayFromImage(volume), np.array(volume.GetDirection()).reshape(3, 3)
series, uid = path("series"), generate_uid()
os.makedirs(series, exist_ok=True)
for n, k in enumerate(random.permutation(numbers.shape[0])):
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = CTImageStorage, generate_uid()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d = FileDataset(None, {}, file_meta=meta, preamble=b"\0" * 128)
    d.SOPClassUID, d.SOPInstanceUID, d.SeriesInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID, uid
    d.PatientName, d.PatientID, d.Modality = "Made^Up", "4711", "CT"
    d.Rows, d.Columns = numbers.shape[1:]
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 1
    d.RescaleSlope, d.RescaleIntercept = 2, -10
    d.PixelSpacing = [volume.GetSpacing()[1], volume.GetSpacing()[0]]
    d.ImagePositionPatient = [f"{x:.10g}" for x in volume.TransformIndexToPhysicalPoint((0, 0, int(k)))]
    d.ImageOrientationPatient = [f"{x:.10g}" for x in np.concatenate([turn[:, 0], turn[:, 1]])]
    d.PixelData = numbers[k].tobytes()
    d.save_as(os.path.join(series, f"{n}"), enforce_file_format=True)
said = glisson("import", series, "-o", path("series.nrrd"))
assert "Made" not in said and "4711" not in said, said
back = sitk.ReadImage(path("series.nrrd"))
assert (sitk.GetArrayFromImage(back) == 2 * numbers - 10).all()
same_place("series", back, volume, 1e-6)
print("a DICOM series of pydicom in random order: same values and places")

# pydicom's own sample files: read as pydicom reads them, or refused with a reason.
samples = os.path.join(os.path.dirname(pydicom.__file__), "data", "test_files")
read, refused = {}, {}
for name in sorted(os.listdir(samples)):
    file = os.path.join(samples, name)
    if not name.endswith(".dcm"):
        continue
    run = subprocess.run([program, "import", file, "--labels", "false", "-o", path("d.nrrd")], capture_output=True, text=True)
    assert run.returncode in (0, 1), (name, run.returncode, run.stderr)
    if run.returncode == 1:
        assert name in run.stderr and len(run.stderr) > len(file) + 20, (name, run.stderr)
        refused[name] = run.stderr.strip()
        continue
    d = pydicom.dcmread(file)
    slope = d.get("DoseGridScaling", d.get("RescaleSlope", 1))
    expected = d.pixel_array.astype(float) * float(slope) + float(d.get("RescaleIntercept", 0))
    found = sitk.GetArrayFromImage(sitk.ReadImage(path("d.nrrd")))
    assert (found.reshape(expected.shape) == expected.astype("float32")).all(), name
    read.setdefault(d.file_meta.TransferSyntaxUID.name, []).append(name)
for syntax, names in read.items():
    print(f"read: {syntax}: {', '.join(names)}")
print(f"refused with a reason: {len(refused)} of {len(refused) + sum(map(len, read.values()))}")
needed = ["Implicit VR Little Endian", "Explicit VR Little Endian", "Explicit VR Big Endian", "RLE Lossless", "JPEG-LS Lossless Image Compression", "JPEG 2000 Image Compression", "JPEG 2000 Image Compression (Lossless Only)"]
assert not set(needed) - set(read), set(needed) - set(read)
assert "rtdose.dcm" in sum(read.values(), []), "frames with offsets"

# Copies of them without the patient: pydicom reads the same pixels, and no text, date or identifier of the original (words of the
# standard, of type CS, remain).
def texts(dataset):
    for e in dataset.iterall():
        if e.VR in ("PN", "LO", "LT", "ST", "UT", "SH", "AE", "DA", "DT", "TM", "UI"):
            values = e.value if isinstance(e.value, (list, pydicom.multival.MultiValue)) else [e.value]
            yield from (str(v) for v in values if v is not None)


copied, uncopied = [], []
for name in sorted(os.listdir(samples)):
    file, out = os.path.join(samples, name), path(f"copy_{name}")
    if not name.endswith(".dcm"):
        continue
    run = subprocess.run([program, "import", file, "--anonymize", out], capture_output=True, text=True)
    assert run.returncode in (0, 1), (name, run.returncode, run.stderr)
    if run.returncode == 1:
        assert name in run.stderr and not os.path.exists(out), (name, run.stderr)
        uncopied.append(name)
        continue
    [copy] = os.listdir(out)
    old, new = pydicom.dcmread(file), pydicom.dcmread(os.path.join(out, copy))
    assert old.file_meta.TransferSyntaxUID == new.file_meta.TransferSyntaxUID, name
    try:
        pixels = old.pixel_array
    except Exception:
        pixels = None
    if pixels is not None:
        assert (pixels == new.pixel_array).all(), name
    data = "\n".join(texts(new))
    for word in set(texts(old)):
        is_of_the_standard = word.startswith("1.2.840.10008.")
        assert len(word) < 5 or is_of_the_standard or word not in data, (name, word)
    assert new.PatientIdentityRemoved == ("NO" if "WARNING" in run.stdout else "YES") and new.PatientName == "ANONYMOUS", name
    copied.append(name)
print(f"copied without the patient, with the pixels that pydicom sees: {len(copied)} of {len(copied) + len(uncopied)} sample files")
assert len(copied) > 30, (copied, uncopied)

# Meshes of meshio, and ours in meshio.
points = np.array([[0, 0, 0], [80, 0, 0], [0, 80, 0], [0, 0, 80], [80, 80, 80]], float)
cells = [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))]
for name in ["m.vtu", "m.vtk", "m22.msh", "m41.msh", "m.inp"]:
    options = {"m22.msh": {"file_format": "gmsh22"}, "m41.msh": {"file_format": "gmsh"}}.get(name, {})
    meshio.write(path(name), meshio.Mesh(points, cells), **options)
    checked = subprocess.run([program, "check", "--json", path(name)], capture_output=True, text=True)
    found = json.loads(checked.stdout)
    assert (found["nodes"], found["tetrahedra"]) == (5, 2), (name, checked.stdout, checked.stderr)
    expected = sum(abs(np.linalg.det(points[c[1:]] - points[c[0]])) for c in cells[0][1]) / 6 * 1e-9
    assert abs(found["volume_m3"] / expected - 1) < 1e-9, (name, found["volume_m3"], expected)
print("meshes of meshio read: vtu, vtk, msh 2.2 and 4.1, inp")

if len(sys.argv) > 3:
    said = json.loads(glisson("import", sys.argv[3], "--json"))
    assert said["dims"] == [438, 353, 165] and any("which side" in note for note in said["notes"]), said
    glisson("mesh", sys.argv[3], "--label", "255", "--tetrahedra", "2000", "-o", path("liver.vtu"))
    seen = meshio.read(path("liver.vtu"))
    assert sum(len(block.data) for block in seen.cells if block.type == "tetra") > 1800
    scene = '''glisson_scene = 1
[organ]
mesh = "liver.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1060 kg/m3"
model = "implicit"
[[organ.fixed]]
furthest = { direction = [0, 0, 1], fraction = 0.1 }
[tool]
tip_radius = "5 mm"
home_tip = ["100 mm", "-60 mm", "100 mm"]
home_shaft = [0, -1, 0]
[[tool.path]]
time = "1 s"
tip = ["100 mm", "60 mm", "100 mm"]
'''
    with open(path("liver.toml"), "w") as out:
        out.write(scene)
    ran = json.loads(glisson("run", path("liver.toml"), "--json"))
    print("CGAL's liver.inr.gz from file to a pushed liver:", {key: value for key, value in ran.items() if "force" in key or "factor" in key})
