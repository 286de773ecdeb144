// Renders a scene of rt with the code of "Ray Tracing in One Weekend" (BOOK=1) or "The Next Week" with its BVH
// (BOOK=2), whose headers come from a checkout: tools/bench_peers compiles this with -I into it.
//
//     book_driver SCENE.txt >image.ppm        writes "seconds S" to standard error
//
// SCENE.txt: width height samples depth, camera (from at up, vfov aperture focus), the number of spheres, and a sphere
// a line: x y z radius kind (lambertian, metal, dielectric) r g b fuzz ior.
// clang-format off
#include "rtweekend.h"
#if BOOK == 2
#include "bvh.h"
#endif
#include "camera.h"
#include "color.h"
#include "hittable_list.h"
#include "material.h"
#include "sphere.h"
// clang-format on

#include <chrono>
#include <fstream>
#include <map>
#include <string>
#include <vector>

int main(int argc, char** argv)
{
	if (argc != 2)
		return 2;
	std::ifstream file(argv[1]);
	int width, height;
	double from[3], at[3], up[3], aperture;
	camera cam;
	file >> width >> height >> cam.samples_per_pixel >> cam.max_depth;
	for (double* v : {from, at, up})
		file >> v[0] >> v[1] >> v[2];
	file >> cam.vfov >> aperture >> cam.focus_dist;
	cam.image_width = width;
	cam.aspect_ratio = width / (height + 0.5); // the book truncates width / ratio
	cam.lookfrom = point3(from[0], from[1], from[2]);
	cam.lookat = point3(at[0], at[1], at[2]);
	cam.vup = vec3(up[0], up[1], up[2]);
	cam.defocus_angle = 2 * std::atan(aperture / 2 / cam.focus_dist) * 180 / pi;

	hittable_list world;
	std::map<std::vector<double>, shared_ptr<material>> materials;
	std::size_t count;
	file >> count;
	for (std::size_t i = 0; i < count; ++i) {
		double x, y, z, radius, r, g, b, fuzz, ior;
		std::string kind;
		file >> x >> y >> z >> radius >> kind >> r >> g >> b >> fuzz >> ior;
		shared_ptr<material>& surface = materials[{double(kind[0]), r, g, b, fuzz, ior}];
		if (!surface && kind == "lambertian")
			surface = make_shared<lambertian>(color(r, g, b));
		else if (!surface && kind == "metal")
			surface = make_shared<metal>(color(r, g, b), fuzz);
		else if (!surface)
			surface = make_shared<dielectric>(ior);
		world.add(make_shared<sphere>(point3(x, y, z), radius, surface));
	}
	if (!file)
		return 7;
	const auto start = std::chrono::steady_clock::now();
#if BOOK == 2
	// The second book's sky has one colour; the mean of the first one's costs the same.
	cam.background = color(0.75, 0.85, 1.0);
	world = hittable_list(make_shared<bvh_node>(world));
#endif
	const auto built = std::chrono::steady_clock::now();
	cam.render(world);
	const auto seconds = [](auto a, auto b) { return std::chrono::duration<double>(b - a).count(); };
	std::clog << "\nload " << seconds(start, built) << "\nseconds "
	          << seconds(built, std::chrono::steady_clock::now()) << '\n';
}
