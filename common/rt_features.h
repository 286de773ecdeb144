/* rt_features.h: what a scene may need of the kernel, one bit each.
 *
 * A program is compiled with RT_FEATURES, a mask of these bits; without it all are on (the generic program).
 * Leaving a bit out deletes code and never changes an expression that remains, so a generic and a specialised
 * program give the same film for every scene that needs no more than the bits left in; a test says so.
 */
#ifndef RT_FEATURES_H
#define RT_FEATURES_H

#define RT_FEATURE_LAMBERTIAN 0x1u    /* diffuse surfaces */
#define RT_FEATURE_METAL 0x2u         /* mirrors */
#define RT_FEATURE_FUZZ 0x4u          /* metal whose reflection is spread */
#define RT_FEATURE_DIELECTRIC 0x8u    /* refraction and Fresnel reflection */
#define RT_FEATURE_EMISSION 0x10u     /* surfaces that emit */
#define RT_FEATURE_CHECKER 0x20u      /* checker textures */
#define RT_FEATURE_IMAGE 0x40u        /* image textures */
#define RT_FEATURE_DEFOCUS 0x80u      /* thin lens */
#define RT_FEATURE_SKY 0x100u         /* a sky that is not black */
#define RT_FEATURE_GRADIENT 0x200u    /* a sky that changes with height */
#define RT_FEATURE_WIDE 0x400u        /* spheres much larger than the smallest: the near-surface form of the test */
#define RT_FEATURE_PERMUTED 0x800u    /* spheres stored in another order than their ids */
#define RT_FEATURE_BVH 0x1000u        /* spheres found through a tree */
#define RT_FEATURE_SOBOL 0x2000u      /* Owen-scrambled Sobol points */
#define RT_FEATURE_STRATIFIED 0x4000u /* a jittered grid over the pixel */
#define RT_FEATURE_LIGHTS 0x8000u     /* rays aimed at lamps */
#define RT_FEATURE_ROULETTE 0x10000u  /* paths ended by Russian roulette */
#define RT_FEATURE_ALL 0x1ffffu

/* X(bit, name, what it is), lowest bit first: for printing */
#define RT_FEATURE_LIST(X)                                                               \
	X(RT_FEATURE_LAMBERTIAN, "lambertian", "diffuse surfaces")                           \
	X(RT_FEATURE_METAL, "metal", "mirrors")                                              \
	X(RT_FEATURE_FUZZ, "fuzz", "metal whose reflection is spread")                       \
	X(RT_FEATURE_DIELECTRIC, "dielectric", "refraction and Fresnel reflection")          \
	X(RT_FEATURE_EMISSION, "emission", "surfaces that emit")                             \
	X(RT_FEATURE_CHECKER, "checker", "checker textures")                                 \
	X(RT_FEATURE_IMAGE, "image", "image textures")                                       \
	X(RT_FEATURE_DEFOCUS, "defocus", "thin lens")                                        \
	X(RT_FEATURE_SKY, "sky", "a sky that is not black")                                  \
	X(RT_FEATURE_GRADIENT, "gradient", "a sky that changes with height")                 \
	X(RT_FEATURE_WIDE, "wide", "spheres much larger than the smallest")                  \
	X(RT_FEATURE_PERMUTED, "permuted", "spheres stored in another order than their ids") \
	X(RT_FEATURE_BVH, "bvh", "spheres found through a tree")                             \
	X(RT_FEATURE_SOBOL, "sobol", "Owen-scrambled Sobol points")                          \
	X(RT_FEATURE_STRATIFIED, "stratified", "a jittered grid over the pixel")             \
	X(RT_FEATURE_LIGHTS, "lights", "rays aimed at lamps")                                \
	X(RT_FEATURE_ROULETTE, "roulette", "paths ended by Russian roulette")

#ifndef RT_FEATURES
#define RT_FEATURES RT_FEATURE_ALL
#endif
/* A tree stores spheres in its own order. */
#if (RT_FEATURES & RT_FEATURE_BVH) != 0u && (RT_FEATURES & RT_FEATURE_PERMUTED) == 0u
#error "rt: RT_FEATURE_BVH needs RT_FEATURE_PERMUTED"
#endif

/* Rays are aimed by diffuse surfaces, at surfaces that emit. */
#if (RT_FEATURES & RT_FEATURE_LIGHTS) != 0u && \
    (RT_FEATURES & (RT_FEATURE_LAMBERTIAN | RT_FEATURE_EMISSION)) != (RT_FEATURE_LAMBERTIAN | RT_FEATURE_EMISSION)
#error "rt: RT_FEATURE_LIGHTS needs RT_FEATURE_LAMBERTIAN and RT_FEATURE_EMISSION"
#endif

/* Usable in #if and in if: is this capability compiled in? */
#define RT_HAS(feature) ((RT_FEATURES & (feature)) != 0u)

#endif
