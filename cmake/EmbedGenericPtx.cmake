# Generic PTX inside the binary, for machines that have a driver and no NVRTC (backends/cuda/generic_program.h).
#
# Included by backends/CMakeLists.txt; gives it
#   rt_kernel_text   static library: the kernels' text and NVRTC, which the build-time program needs too
#   RT_GENERIC_PTX   a C++ file with the table of embedded programs
# The table is empty where NVRTC cannot be loaded during the build; that is told and is no error.
option(RT_EMBED_PTX "Embed PTX of the generic programs if NVRTC can be loaded during the build" ON)

add_library(rt_kernel_text STATIC kernel_syntax.cpp kernel_text.cpp traced_text.cpp "${RT_EMBEDDED}" cuda/generic_program.cpp cuda/nvrtc.cpp)
set_source_files_properties("${RT_EMBEDDED}" PROPERTIES GENERATED TRUE)
add_dependencies(rt_kernel_text rt_embedded_text)
target_link_libraries(rt_kernel_text PUBLIC rt_support PRIVATE rt_warnings)

set(RT_GENERIC_PTX "${CMAKE_CURRENT_BINARY_DIR}/generic_ptx.cpp")
if(RT_EMBED_PTX AND NOT CMAKE_CROSSCOMPILING)
  add_executable(rt_make_ptx "${PROJECT_SOURCE_DIR}/tools/make_ptx.cpp")
  target_link_libraries(rt_make_ptx PRIVATE rt_kernel_text rt_warnings)
  # NVRTC keeps memory until its process ends: no leak of ours, and no reason for a sanitizer to fail the build.
  add_custom_command(
    OUTPUT "${RT_GENERIC_PTX}"
    COMMAND ${CMAKE_COMMAND} -E env ASAN_OPTIONS=detect_leaks=0 $<TARGET_FILE:rt_make_ptx> "${RT_GENERIC_PTX}"
    DEPENDS rt_make_ptx
    COMMENT "Compiling the generic programs to PTX"
    VERBATIM)
else()
  message(STATUS "rt: no generic PTX is embedded (RT_EMBED_PTX=${RT_EMBED_PTX}); NVIDIA GPUs will need NVRTC at run time")
  file(CONFIGURE OUTPUT "${RT_GENERIC_PTX}" CONTENT [[
#include "backends/cuda/generic_program.h"
namespace rt {
const EmbeddedPtx embedded_ptx[] = {{nullptr, nullptr}};
const char embedded_ptx_compiler[] = "";
} // namespace rt
]] @ONLY)
endif()
