/* scene_view.h: everything of a scene, as the kernels hand it on. */
#ifndef RT_SCENE_VIEW_H
#define RT_SCENE_VIEW_H

#include "common/rt_structs.h"

typedef struct rt_scene_view {
	RT_UNIFORM const rt_scene* scene;
	RT_UNIFORM const rt_few_spheres* few; /* filled only where a program is made for so few */
	RT_GLOBAL const rt_sphere* spheres;
	RT_GLOBAL const rt_wide* wide;
	RT_GLOBAL const rt_u32* sphere_ids;
	RT_GLOBAL const rt_u32* sphere_materials;
	RT_GLOBAL const rt_row4* bvh; /* nodes, then blocks */
	RT_GLOBAL const rt_material* materials;
	RT_GLOBAL const rt_texture* textures;
	RT_GLOBAL const rt_u32* texels;
	RT_GLOBAL const rt_light* lights; /* only where rays are aimed at lamps */
} rt_scene_view;

/* What a kernel is given of a scene, in the order of its parameters. */
RT_FN rt_scene_view rt_scene_viewed(RT_UNIFORM const rt_scene* scene, RT_UNIFORM const rt_few_spheres* few,
                                    RT_GLOBAL const rt_sphere* spheres, RT_GLOBAL const rt_wide* wide,
                                    RT_GLOBAL const rt_u32* sphere_ids, RT_GLOBAL const rt_u32* sphere_materials,
                                    RT_GLOBAL const rt_row4* bvh, RT_GLOBAL const rt_material* materials,
                                    RT_GLOBAL const rt_texture* textures, RT_GLOBAL const rt_u32* texels,
                                    RT_GLOBAL const rt_light* lights)
{
	rt_scene_view view;
	view.scene = scene;
	view.few = few;
	view.spheres = spheres;
	view.wide = wide;
	view.sphere_ids = sphere_ids;
	view.sphere_materials = sphere_materials;
	view.bvh = bvh;
	view.materials = materials;
	view.textures = textures;
	view.texels = texels;
	view.lights = lights;
	return view;
}

#endif
