#include "backends/render_launch.h"

namespace rt {

std::vector<Argument> render_arguments(const rt_scene& scene, const rt_few_spheres& few, const SceneBuffers& lists,
                                       const BufferHandle& film, const RenderRange& range)
{
	return {by_value(scene), by_value(few),   lists.spheres,      lists.wide,    lists.ids,    lists.sphere_materials,
	        lists.bvh,       lists.materials, lists.textures,     lists.texels,  lists.lights, film,
	        range.first_row, range.rows,      range.first_sample, range.samples, range.slices, range.slice_pixels};
}

} // namespace rt
