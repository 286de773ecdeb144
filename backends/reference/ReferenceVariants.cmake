# The reference backend's compiled variants: one object library each, and a table of them.
#
# A specialised variant serves every scene that needs no more than its features; the smallest that fits is taken. The
# masks are those of the shipped scenes (common/rt_features.h). On x86-64 each is built for x86-64-v3 (AVX2, FMA), and
# the generic ones also for the baseline, where the C library's fma is exact and slow.
set(RT_REFERENCE_DECLARATIONS "")
set(RT_REFERENCE_TABLE "")

# After v3, CONTRACTED: the compiler may fuse, which tests use to show that it finds nothing to fuse (rule 3).
function(rt_reference_variant name features native_roots v3)
  set(contracted 0)
  if("CONTRACTED" IN_LIST ARGN)
    set(contracted 1)
  endif()
  set(target rt_reference_${name})
  add_library(${target} OBJECT reference/reference_kernels.cpp)
  target_include_directories(${target} PRIVATE "${PROJECT_SOURCE_DIR}")
  target_compile_definitions(${target} PRIVATE RT_VARIANT=${name} RT_FEATURES=${features}
                             RT_DEF_NATIVE_ROOTS=${native_roots} RT_VARIANT_V3=${v3} RT_DEF_CONTRACT=${contracted}
                             RT_TRACED=0)
  # -O3 whatever the preset: this is a backend.
  target_compile_options(${target} PRIVATE -O3 -fno-math-errno)
  if(v3)
    target_compile_options(${target} PRIVATE -march=x86-64-v3)
  endif()
  target_link_libraries(${target} PRIVATE rt_warnings rt_kernel_warnings)
  if(contracted)
    target_compile_options(${target} PRIVATE -ffp-contract=fast)
  else()
    target_link_libraries(${target} PRIVATE rt_strict_fp)
  endif()
  target_sources(rt_backends PRIVATE $<TARGET_OBJECTS:${target}>)
  set(RT_REFERENCE_DECLARATIONS "${RT_REFERENCE_DECLARATIONS}extern const ReferenceVariant ${name};\n" PARENT_SCOPE)
  set(RT_REFERENCE_TABLE "${RT_REFERENCE_TABLE}\t&${name},\n" PARENT_SCOPE)
endfunction()

if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  set(RT_FAST 1)
  rt_reference_variant(generic_baseline 0x1fffu 1 0)
else()
  set(RT_FAST 0)
endif()
rt_reference_variant(generic 0x1fffu 1 ${RT_FAST})
rt_reference_variant(generic_software_roots 0x1fffu 0 ${RT_FAST})
rt_reference_variant(generic_contracted 0x1fffu 1 ${RT_FAST} CONTRACTED)
rt_reference_variant(matte 0x301u 1 ${RT_FAST})    # lambertian, sky, gradient
rt_reference_variant(classic 0x70fu 1 ${RT_FAST})  # + metal, fuzz, dielectric, wide
rt_reference_variant(lens 0x78fu 1 ${RT_FAST})     # + defocus
rt_reference_variant(textured 0x76fu 1 ${RT_FAST}) # classic + checker, image
rt_reference_variant(cloud 0x1b01u 1 ${RT_FAST})   # matte + permuted, bvh
rt_reference_variant(crowd 0x1f8fu 1 ${RT_FAST})   # lens + permuted, bvh
rt_reference_variant(lamps 0x41fu 1 ${RT_FAST})    # lambertian, metal, fuzz, dielectric, emission, wide

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
target_compile_definitions(rt_reference_traced PRIVATE RT_VARIANT=traced RT_VARIANT_V3=0 RT_DEF_CONTRACT=0
                           RT_DEF_NATIVE_ROOTS=1 RT_TRACED=1)
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
