# The reference backend's compiled variants: one object library each, and a table of them.
#
# The generic variants of one lane are the oracle; those of several lanes (vectors) are the fast ones. A specialised
# variant serves every scene that needs no more than its features; the smallest that fits is taken. The masks are those
# of the shipped scenes (common/rt_features.h). On x86-64 a variant is built for an instruction set: 3, x86-64-v3 (AVX2,
# FMA); 4, x86-64-v4 (AVX-512); 0, the baseline, where fma is the C library's, exact and slow.
set(RT_REFERENCE_VARIANTS "all" CACHE STRING
    "Variants of the reference backend: all, or few (generic ones: slower renders, a build in a third of the time)")
set_property(CACHE RT_REFERENCE_VARIANTS PROPERTY STRINGS all few)
if(NOT RT_REFERENCE_VARIANTS MATCHES "^(all|few)$")
  message(FATAL_ERROR "RT_REFERENCE_VARIANTS is '${RT_REFERENCE_VARIANTS}'; it is all or few")
endif()

set(RT_ALL RT_FEATURE_ALL)
set(RT_REFERENCE_DECLARATIONS "")
set(RT_REFERENCE_TABLE "")

# After the instruction set: SOFTWARE_ROOTS, and CONTRACTED: the compiler may fuse, which tests use to show that it
# finds nothing to fuse (rule 3); or one of FAST and DOUBLE, the rungs beside the exact one (common/rt_compat.h); or
# EXHAUST, kernels/exhaust.cl and kernels/probe_paths.cl instead of a render's kernels.
function(rt_reference_variant name lanes features instruction_set)
  cmake_parse_arguments(PARSE_ARGV 4 variant "SOFTWARE_ROOTS;CONTRACTED;FAST;DOUBLE;EXHAUST" "" "")
  set(native_roots 1)
  if(variant_SOFTWARE_ROOTS)
    set(native_roots 0)
  endif()
  set(contracted 0)
  if(variant_CONTRACTED)
    set(contracted 1)
  endif()
  set(precision 0)
  if("FAST" IN_LIST ARGN)
    set(precision 1)
  elseif("DOUBLE" IN_LIST ARGN)
    set(precision 2)
  endif()
  set(target rt_reference_${name})
  set(source reference/reference_kernels.cpp)
  if(variant_EXHAUST)
    set(source reference/reference_exhaust.cpp)
  endif()
  add_library(${target} OBJECT ${source})
  target_include_directories(${target} PRIVATE "${PROJECT_SOURCE_DIR}")
  target_compile_definitions(${target} PRIVATE RT_VARIANT=${name} RT_LANES=${lanes} RT_FEATURES=${features}
                             RT_DEF_NATIVE_ROOTS=${native_roots} RT_DEF_CONTRACT=${contracted}
                             RT_VARIANT_SET=${instruction_set} RT_PRECISION=${precision} RT_TRACED=0)
  # -O3 whatever the preset: this is a backend. Passing vectors wider than a register has no settled ABI, which does
  # not matter within one object.
  target_compile_options(${target} PRIVATE -O3 -fno-math-errno -Wno-psabi)
  # In a sanitized build the specialised variants, the contracted ones and those of 4 and 16 lanes are left as they are
  # in any other: they are the text of the generic ones, and so one build shows both the text's faults and the films of
  # this compiler's optimised code.
  if(CMAKE_CXX_FLAGS MATCHES "-fsanitize" AND
     (contracted OR NOT features STREQUAL RT_ALL OR NOT "${lanes}" MATCHES "^(1|${RT_FAST_LANES})$"))
    target_compile_options(${target} PRIVATE -fno-sanitize=all)
  endif()
  if(instruction_set)
    target_compile_options(${target} PRIVATE -march=x86-64-v${instruction_set})
  endif()
  target_link_libraries(${target} PRIVATE rt_warnings rt_kernel_warnings)
  if(precision EQUAL 2)
    target_link_libraries(${target} PRIVATE rt_double_warnings)
  endif()
  if(contracted OR precision EQUAL 1)
    target_compile_options(${target} PRIVATE -ffp-contract=fast)
  else()
    target_link_libraries(${target} PRIVATE rt_strict_fp)
  endif()
  target_sources(rt_backends PRIVATE $<TARGET_OBJECTS:${target}>)
  set(RT_REFERENCE_DECLARATIONS "${RT_REFERENCE_DECLARATIONS}extern const ReferenceVariant ${name};\n" PARENT_SCOPE)
  set(RT_REFERENCE_TABLE "${RT_REFERENCE_TABLE}\t&${name},\n" PARENT_SCOPE)
endfunction()

# The specialised variants have the number of lanes that is fastest on their instruction set, and by them the backend
# knows it. Without fma instructions that is one.
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  set(RT_FAST 3)
  set(RT_FAST_LANES 8)
  rt_reference_variant(generic_baseline 1 ${RT_ALL} 0)
  if(RT_REFERENCE_VARIANTS STREQUAL "all")
    rt_reference_variant(generic_16_v4 16 ${RT_ALL} 4)
  endif()
  rt_reference_variant(fast_baseline 1 ${RT_ALL} 0 FAST)
  rt_reference_variant(double_baseline 1 ${RT_ALL} 0 DOUBLE)
  rt_reference_variant(exhaust_baseline 1 ${RT_ALL} 0 EXHAUST)
  rt_reference_variant(exhaust_baseline_software_roots 1 ${RT_ALL} 0 EXHAUST SOFTWARE_ROOTS)
else()
  set(RT_FAST 0)
  set(RT_FAST_LANES 4)
endif()
foreach(lanes 1 4 8 16)
  rt_reference_variant(generic_${lanes} ${lanes} ${RT_ALL} ${RT_FAST})
  rt_reference_variant(generic_${lanes}_software_roots ${lanes} ${RT_ALL} ${RT_FAST} SOFTWARE_ROOTS)
endforeach()
foreach(lanes 1 ${RT_FAST_LANES})
  rt_reference_variant(generic_${lanes}_contracted ${lanes} ${RT_ALL} ${RT_FAST} CONTRACTED)
  rt_reference_variant(fast_generic_${lanes} ${lanes} ${RT_ALL} ${RT_FAST} FAST)
endforeach()
rt_reference_variant(double_generic 1 ${RT_ALL} ${RT_FAST} DOUBLE)
rt_reference_variant(exhaust ${RT_FAST_LANES} ${RT_ALL} ${RT_FAST} EXHAUST)
rt_reference_variant(exhaust_software_roots ${RT_FAST_LANES} ${RT_ALL} ${RT_FAST} EXHAUST SOFTWARE_ROOTS)
# The feature masks that shipped scenes need.
set(rungs exact fast)
if(RT_REFERENCE_VARIANTS STREQUAL "few")
  set(rungs "")
elseif(CMAKE_CXX_FLAGS MATCHES "-fsanitize")
  set(rungs exact) # of these builds only the exact rung's films are held against anything
endif()
foreach(rung IN LISTS rungs)
  set(prefix "")
  set(option "")
  if(rung STREQUAL "fast")
    set(prefix "fast_")
    set(option FAST)
  endif()
  rt_reference_variant(${prefix}matte ${RT_FAST_LANES} 0x301u ${RT_FAST} ${option})    # lambertian, sky, gradient
  rt_reference_variant(${prefix}classic ${RT_FAST_LANES} 0x70fu ${RT_FAST} ${option})  # + metal, fuzz, dielectric, wide
  rt_reference_variant(${prefix}lens ${RT_FAST_LANES} 0x78fu ${RT_FAST} ${option})     # + defocus
  rt_reference_variant(${prefix}textured ${RT_FAST_LANES} 0x76fu ${RT_FAST} ${option}) # classic + checker, image
  rt_reference_variant(${prefix}cloud ${RT_FAST_LANES} 0x1b01u ${RT_FAST} ${option})   # matte + permuted, bvh
  rt_reference_variant(${prefix}crowd ${RT_FAST_LANES} 0x1f8fu ${RT_FAST} ${option})   # lens + permuted, bvh
  rt_reference_variant(${prefix}lamps ${RT_FAST_LANES} 0x41fu ${RT_FAST} ${option})    # lambertian, metal, fuzz,
                                                                                       # dielectric, emission, wide
  # The same with what a user may ask for: other samplers, roulette, aimed rays. Of these only the last is dear where it
  # is not asked for (a fifth of the time), so that the others share a variant.
  rt_reference_variant(${prefix}sampled ${RT_FAST_LANES} 0x1671fu ${RT_FAST} ${option}) # classic + emission, sobol,
                                                                                        # stratified, roulette
  rt_reference_variant(${prefix}sampled_crowd ${RT_FAST_LANES} 0x17f8fu ${RT_FAST} ${option}) # crowd + the same
  rt_reference_variant(${prefix}aimed_lamps ${RT_FAST_LANES} 0x841fu ${RT_FAST} ${option})    # lamps + lights
  rt_reference_variant(${prefix}aimed ${RT_FAST_LANES} 0x1e71fu ${RT_FAST} ${option})         # sampled + lights
endforeach()

# The traced kernels are a text that is made while rt is built. -O1: they trace single samples, and are large.
add_executable(rt_make_traced "${PROJECT_SOURCE_DIR}/tools/make_traced.cpp")
target_link_libraries(rt_make_traced PRIVATE rt_kernel_text rt_warnings)
set(RT_TRACED_DIRECTORY "${CMAKE_CURRENT_BINARY_DIR}/traced")
add_custom_command(
  OUTPUT "${RT_TRACED_DIRECTORY}/traced_kernels.inc"
  COMMAND ${CMAKE_COMMAND} -E make_directory "${RT_TRACED_DIRECTORY}"
  COMMAND $<TARGET_FILE:rt_make_traced> "${RT_TRACED_DIRECTORY}/traced_kernels.inc"
  DEPENDS rt_make_traced
  COMMENT "Putting notes into the kernels' text"
  VERBATIM)
add_library(rt_reference_traced OBJECT reference/reference_kernels.cpp "${RT_TRACED_DIRECTORY}/traced_kernels.inc")
target_include_directories(rt_reference_traced PRIVATE "${PROJECT_SOURCE_DIR}" "${RT_TRACED_DIRECTORY}")
target_compile_definitions(rt_reference_traced PRIVATE RT_VARIANT=traced RT_VARIANT_SET=0 RT_LANES=1
                           RT_DEF_CONTRACT=0 RT_DEF_NATIVE_ROOTS=1 RT_PRECISION=0 RT_TRACED=1)
target_compile_options(rt_reference_traced PRIVATE -w -O1 -fno-math-errno)
target_link_libraries(rt_reference_traced PRIVATE rt_strict_fp)
target_sources(rt_backends PRIVATE $<TARGET_OBJECTS:rt_reference_traced>)
string(APPEND RT_REFERENCE_DECLARATIONS "extern const ReferenceVariant traced;\n")
string(APPEND RT_REFERENCE_TABLE "\t&traced,\n")

file(CONFIGURE OUTPUT "${CMAKE_CURRENT_BINARY_DIR}/reference_variants.cpp" CONTENT
"// Made by ReferenceVariants.cmake; do not edit.
#include \"backends/reference/reference_kernels.h\"

namespace rt {

@RT_REFERENCE_DECLARATIONS@
const ReferenceVariant* const reference_variants[] = {
@RT_REFERENCE_TABLE@};
const unsigned reference_variant_count = sizeof reference_variants / sizeof reference_variants[0];

} // namespace rt
" @ONLY)
target_sources(rt_backends PRIVATE "${CMAKE_CURRENT_BINARY_DIR}/reference_variants.cpp")
