"""Renders a scene of rt with Mitsuba 3, in an interpreter that has it: tools/bench_peers starts it.

    mitsuba_worker.py JOB.json      writes one JSON object to standard output

JOB: variant, scene (what `rt info --json` says), spheres (file of `rt info --spheres`), width, height, samples,
rr_depth (null: Mitsuba's default), slope_of_fuzz, threads, repeats, image (file for the last film as raw floats, or
null), seed.

Mitsuba's roughconductor is the nearest it has to a fuzzy metal, so images agree in cost and not in every pixel.
"""

import json
import sys
import time

import mitsuba as mi
import numpy as np

# Above this many, one `ellipsoids` shape a material serves them; as single shapes they take minutes to load.
MOST_SINGLE_SHAPES = 2000


def rgb(value):
    return {"type": "rgb", "value": list(value)}


def bsdf_of(material, hollow, slope_of_fuzz):
    kind = material["kind"]
    if material["texture"] is not None or any(material["emission"]):
        raise SystemExit(f"a {kind} with a texture or an emission is not translated")
    if kind == "lambertian":
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(material["albedo"])}}
    if kind == "metal":
        surface = {"type": "conductor", "material": "none", "specular_reflectance": rgb(material["albedo"])}
        if material["fuzz"] > 0:
            surface.update({"type": "roughconductor", "alpha": slope_of_fuzz * material["fuzz"]})
        return {"type": "twosided", "bsdf": surface}
    if kind == "dielectric":
        return {"type": "dielectric", "int_ior": 1 / material["ior"] if hollow else material["ior"], "ext_ior": 1.0}
    raise SystemExit(f"material kind {kind} is not translated")


def sky_of(sky):
    if sky["kind"] == "constant":
        return {"type": "constant", "radiance": rgb(sky["bottom"])}
    if sky["kind"] == "none":
        return None
    rows = 512
    height = np.cos((np.arange(rows) + 0.5) / rows * np.pi)[:, None, None]
    bottom, top = np.array(sky["bottom"]), np.array(sky["top"])
    image = np.broadcast_to(bottom + (height + 1) / 2 * (top - bottom), (rows, 4, 3)).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image))}


def shapes_of(scene, path, slope_of_fuzz):
    spheres = np.fromfile(path, dtype="<f4").reshape(-1, 4)
    materials = np.fromfile(path + ".materials", dtype="<u4")
    shapes = {}
    if len(spheres) <= MOST_SINGLE_SHAPES:
        for i, (x, y, z, radius) in enumerate(spheres.tolist()):
            surface = bsdf_of(scene["material_list"][materials[i]], radius < 0, slope_of_fuzz)
            shapes[f"sphere{i}"] = {"type": "sphere", "center": [x, y, z], "radius": abs(radius), "bsdf": surface}
        return shapes
    for i, material in enumerate(scene["material_list"]):
        own = spheres[materials == i]
        if len(own) == 0:
            continue
        if (own[:, 3] < 0).any():
            raise SystemExit("hollow spheres in a large set are not translated")
        quaternions = np.zeros((len(own), 4), dtype=np.float32)
        quaternions[:, 3] = 1
        shapes[f"set{i}"] = {"type": "ellipsoids", "centers": mi.TensorXf(np.ascontiguousarray(own[:, :3])),
                             "scales": mi.TensorXf(np.repeat(own[:, 3:], 3, axis=1)),
                             "quaternions": mi.TensorXf(quaternions), "extent": 1.0,
                             "bsdf": bsdf_of(material, False, slope_of_fuzz)["bsdf"]}
    return shapes


def scene_of(job):
    scene, camera = job["scene"], job["scene"]["camera"]
    integrator = {"type": "path", "max_depth": scene["render"]["max_depth"] + 1}
    if job["rr_depth"] is not None:
        integrator["rr_depth"] = job["rr_depth"]
    sensor = {
        "type": "perspective", "fov": camera["vfov"], "fov_axis": "y", "near_clip": 1e-3, "far_clip": 1e6,
        "to_world": mi.ScalarTransform4f().look_at(camera["from"], camera["at"], camera["up"]),
        "film": {"type": "hdrfilm", "width": job["width"], "height": job["height"], "pixel_format": "rgb",
                 "component_format": "float32", "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": job["samples"]},
    }
    if camera["aperture"] > 0:
        sensor.update({"type": "thinlens", "aperture_radius": camera["aperture"] / 2,
                       "focus_distance": camera["focus"]})
    world = {"type": "scene", "integrator": integrator, "sensor": sensor}
    sky = sky_of(scene["sky"])
    if sky:
        world["sky"] = sky
    world.update(shapes_of(scene, job["spheres"], job["slope_of_fuzz"]))
    return mi.load_dict(world)


def main():
    job = json.load(open(sys.argv[1]))
    if job["variant"] not in mi.variants():
        raise SystemExit(f"this Mitsuba has no variant {job['variant']}")
    mi.set_variant(job["variant"])
    import drjit as dr
    if job["threads"]:
        dr.set_thread_count(job["threads"])
    start = time.perf_counter()
    world = scene_of(job)
    load = time.perf_counter() - start
    seconds = []
    for repeat in range(job["repeats"] + 1):
        start = time.perf_counter()
        image = np.array(mi.render(world, seed=job["seed"] + repeat, spp=job["samples"]))
        seconds.append(time.perf_counter() - start)
    if job["image"]:
        image.astype("<f4").tofile(job["image"])
    json.dump({"version": mi.__version__, "load_seconds": load, "first_seconds": seconds[0], "seconds": seconds[1:],
               "mean": float(image.mean(dtype=np.float64))}, sys.stdout)


main()
