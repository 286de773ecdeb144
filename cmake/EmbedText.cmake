# Writes a C++ file that holds text files as byte arrays:
#   cmake -DOUTPUT=out.cpp -DROOT=/source -DFILES="kernels/a.h;common/b.h" -P EmbedText.cmake
# The table is declared in backends/embedded_text.h. Bytes, not string literals: compilers limit a literal's length.
set(body "// Made by cmake/EmbedText.cmake; do not edit.\n#include \"backends/embedded_text.h\"\n\nnamespace rt {\n\n")
set(table "")
foreach(file IN LISTS FILES)
  file(READ "${ROOT}/${file}" hex HEX)
  string(MAKE_C_IDENTIFIER "${file}" name)
  string(REGEX REPLACE "(..)" "0x\\1," bytes "${hex}")
  string(REGEX REPLACE "(................................................................................)" "\\1\n\t" bytes "${bytes}")
  string(APPEND body "static const unsigned char text_${name}[] = {\n\t${bytes}\n};\n\n")
  string(APPEND table "\t{\"${file}\", reinterpret_cast<const char*>(text_${name}), sizeof text_${name}},\n")
endforeach()
string(APPEND body "const EmbeddedText embedded_texts[] = {\n${table}};\nconst unsigned embedded_text_count = sizeof embedded_texts / sizeof embedded_texts[0];\n\n} // namespace rt\n")
file(WRITE "${OUTPUT}" "${body}")
