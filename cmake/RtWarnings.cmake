# One place for warnings and for the host's floating-point rules.
#
# rt_warnings: applied to every target of the project; warnings are errors in CI (RT_WERROR).
# rt_strict_fp: value-changing optimisations off. The arithmetic does not rely on these flags (no product feeds a
# bare + or -, contract rule 3); they are the second line.
add_library(rt_warnings INTERFACE)
target_compile_options(rt_warnings INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wdouble-promotion
                       -Wnon-virtual-dtor)
# Not -Wold-style-cast: the kernels' headers cast as C does; clang-tidy watches the host's code.
option(RT_WERROR "Warnings are errors" OFF)
if(RT_WERROR)
  target_compile_options(rt_warnings INTERFACE -Werror)
endif()

# For kernels: a specialised variant does not use every parameter and variable.
add_library(rt_kernel_warnings INTERFACE)
target_compile_options(rt_kernel_warnings INTERFACE -Wno-unused-parameter -Wno-unused-variable
                       -Wno-unused-but-set-variable)

# For the double rung: float literals and the scene's float numbers become doubles, which is exact.
add_library(rt_double_warnings INTERFACE)
target_compile_options(rt_double_warnings INTERFACE -Wno-double-promotion)

add_library(rt_strict_fp INTERFACE)
target_compile_options(rt_strict_fp INTERFACE -ffp-contract=off -fno-fast-math)
