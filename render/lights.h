// lights.h: the table by which kernels choose the lamp that a ray is aimed at (kernels/light.h).
//
// A lamp is a sphere that emits. It is chosen with probability 1/2 (its share of the power, emission times area) + 1/2
// (1 / number of lamps): what is bright and large is chosen often, and what is near but faint not too seldom, which
// bounds a sample. The table is made from the packed scene in double, so every device and storage order has the same.
#pragma once

#include "render/pack.h"
#include "support/result.h"

#include <vector>

namespace rt {

// Fills packed.lights and the scene's light_ members, and sets RT_FEATURE_LIGHTS, if there are lamps and diffuse
// surfaces; otherwise rays have nothing to aim at, and the scene's estimator becomes RT_ESTIMATOR_PATH. To be called
// when the spheres, materials and features are packed. Errors (Usage): more than RT_MAX_LIGHTS lamps.
Status pack_lights(PackedScene& packed);

// The largest emission over its lamp's probability of being chosen; 0 without lamps.
double brightest_choice(const PackedScene& packed);

// Makes the table of `out` point to the same spheres as that of `before`, whose spheres `out` stores in another order.
void follow_spheres(const PackedScene& before, PackedScene& out);

} // namespace rt
