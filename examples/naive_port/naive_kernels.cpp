#include "examples/naive_port/naive_kernels.h"

#include <algorithm>

namespace rt {
namespace {

// The spheres of "Ray Tracing in One Weekend" and of most first path tracers: b^2 - 4ac, two roots, and an epsilon in
// place of knowing which sphere the ray leaves.
const char* const distance = R"(
RT_FN rt_float rt_sphere_distance(rt_vec3 center, rt_float radius, rt_ray ray, rt_mask is_from, RT_PRIVATE rt_mask* met)
{
	rt_vec3 oc = v3_sub(rt_ray_origin(ray), center);
	rt_float a = v3_dot(ray.dir, ray.dir);
	rt_float b = 2.0f * v3_dot(oc, ray.dir);
	rt_float c = v3_dot(oc, oc) - radius * radius;
	rt_float discriminant = b * b - 4.0f * a * c;
	rt_float root = rt_sqrt(discriminant);
	rt_float t = (-b - root) / (2.0f * a);
	t = rt_sel(t > rt_splat(1e-3f), t, (-b + root) / (2.0f * a));
	*met = (discriminant >= rt_splat(0.0f)) & (t > rt_splat(1e-3f));
	return t;
}
)";

// A large sphere is a sphere.
const char* const wide_distance = R"(
RT_FN rt_float rt_wide_distance(rt_vec3 center, rt_float radius, rt_float c0_high, rt_float c0_low, rt_ray ray,
                                rt_vec3 origin, rt_float origin_square, rt_mask is_from, RT_PRIVATE rt_mask* met)
{
	return rt_sphere_distance(center, radius, ray, is_from, met);
}
)";

// The point on the ray, and the normal from it.
const char* const surface = R"(
RT_FN rt_surface rt_sphere_surface(RT_UNIFORM const rt_scene* scene, RT_GLOBAL const rt_sphere* RT_RESTRICT spheres,
                                   rt_ray ray, rt_float t, rt_int index)
{
	rt_surface s;
	rt_vec3 center =
	    v3(RT_GATHER_F(spheres, index, .cx), RT_GATHER_F(spheres, index, .cy), RT_GATHER_F(spheres, index, .cz));
	s.radius = RT_GATHER_F(spheres, index, .radius);
	s.base = v3_add(rt_ray_origin(ray), v3_scale(t, ray.dir));
	s.normal = v3_scale(rt_splat(1.0f) / s.radius, v3_sub(s.base, center));
	s.arm = s.normal;
	s.reach = rt_splat(0.0f);
	return s;
}
)";

const char* const native_root = "RT_FN rt_float rt_root(rt_float x) { return native_sqrt(x); }";
const char* const native_reciprocal = "RT_FN rt_float rt_rcp(rt_float x) { return native_recip(x); }";
const char* const native_sincos = R"(
RT_FN void rt_sincos_turns(rt_float u, RT_PRIVATE rt_float* sine, RT_PRIVATE rt_float* cosine)
{
	*sine = native_sin(6.2831853f * u);
	*cosine = native_cos(6.2831853f * u);
}
)";

// A float for each channel, which the sum's first word keeps.
const char* const float_sample = R"(
RT_FN rt_channel_sum rt_channel_sample(rt_float v, float scale, float scale_high)
{
	rt_channel_sum one;
	one.high = rt_bits(v * scale);
	one.low = rt_splat_u(0u);
	return one;
}
)";
const char* const float_add = R"(
RT_FN rt_channel_sum rt_channel_add(rt_channel_sum sum, rt_mask mask, rt_channel_sum other)
{
	sum.high = rt_bits(rt_from_bits(sum.high) + rt_sel(mask, rt_from_bits(other.high), rt_splat(0.0f)));
	return sum;
}
)";
const char* const float_total = R"(
RT_FN rt_i64 rt_channel_total(rt_u32 high, rt_u32 low, rt_u32 samples)
{
	return (rt_i64)as_float(high);
}
)";

std::string on_one_line(std::string text)
{
	std::replace(text.begin(), text.end(), '\n', ' ');
	return text;
}

// Puts `naive` before a function whose text begins with `begin`, which then gets another name and is not called.
TextEdit instead_of(const std::string& file, const std::string& begin, const std::string& name,
                    const std::string& naive)
{
	std::string renamed = begin;
	renamed.replace(renamed.find(name), name.size(), name + "_of_rt");
	return {file, begin, on_one_line(naive) + " " + renamed};
}

const char* const math = "kernels/math.h";
const char* const sphere = "kernels/sphere.h";
const char* const film = "kernels/film.h";

} // namespace

const std::vector<NaiveHabit>& naive_habits()
{
	static const std::vector<NaiveHabit> habits = {
	    // OpenCL's compilers may fuse such sums unless they are told not to.
	    {"dot",
	     {{"kernels/vec.h", "return rt_fma(a.x, b.x, rt_fma(a.y, b.y, a.z * b.z));",
	       "return a.x * b.x + a.y * b.y + a.z * b.z;"}},
	     true},
	    // Both where the kernels use the device's roots and where they use ours.
	    {"native",
	     {{math, "RT_FN rt_float rt_root(rt_float x) { return rt_native_sqrt(x); }", native_root},
	      {math, "RT_FN rt_float rt_rcp(rt_float x) { return rt_native_rcp(x); }", native_reciprocal},
	      instead_of(math, "RT_FN rt_float rt_root(rt_float x)\n", "rt_root", native_root),
	      instead_of(math, "RT_FN rt_float rt_rcp(rt_float x)\n", "rt_rcp", native_reciprocal),
	      instead_of(math,
	                 "RT_FN void rt_sincos_turns(rt_float u, RT_PRIVATE rt_float* sine, RT_PRIVATE rt_float* "
	                 "cosine)\n{\n\trt_int quadrant",
	                 "rt_sincos_turns", native_sincos)}},
	    {"quadratic",
	     {instead_of(sphere, "RT_FN rt_float rt_sphere_distance(", "rt_sphere_distance", distance),
	      instead_of(sphere, "RT_FN rt_float rt_wide_distance(", "rt_wide_distance", wide_distance),
	      instead_of(sphere, "RT_FN rt_surface rt_sphere_surface(", "rt_sphere_surface", surface),
	      {sphere, "rt_mask inward = ray.chord > rt_splat(0.0f);", "rt_mask inward = RT_FALSE;"}}},
	    {"sums",
	     {instead_of(film, "RT_FN rt_channel_sum rt_channel_sample(", "rt_channel_sample", float_sample),
	      instead_of(film, "RT_FN rt_channel_sum rt_channel_add(", "rt_channel_add", float_add),
	      instead_of(film, "RT_FN rt_i64 rt_channel_total(", "rt_channel_total", float_total)}},
	};
	return habits;
}

} // namespace rt
