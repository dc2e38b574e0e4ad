# Turns OpenCL sources, and other texts, into C strings: embed_cl(target render/project.cl ...) gives `const char project_cl[]`.
# Included by the top CMakeLists.txt; run by itself in script mode it is the generator.
set(EMBED_SCRIPT ${CMAKE_CURRENT_LIST_FILE})
function(embed_cl target)
  foreach(src ${ARGN})
    get_filename_component(stem ${src} NAME)
    string(REPLACE "." "_" sym ${stem})
    set(out ${CMAKE_CURRENT_BINARY_DIR}/embed/${sym}.c)
    add_custom_command(OUTPUT ${out} DEPENDS ${src} ${EMBED_SCRIPT} VERBATIM
      COMMAND ${CMAKE_COMMAND} -DIN=${CMAKE_CURRENT_SOURCE_DIR}/${src} -DOUT=${out} -DSYM=${sym}
              -P ${EMBED_SCRIPT})
    target_sources(${target} PRIVATE ${out})
  endforeach()
endfunction()
if(CMAKE_SCRIPT_MODE_FILE AND IN)
  file(READ ${IN} hex HEX)
  # "#include", which only C sees, becomes a comment: PoCL runs a preprocessor over every source that has the word, at
  # every start, before it looks into its cache.
  string(REPLACE "23696e636c756465" "2f2f202020202020" hex "${hex}")
  string(REGEX REPLACE "(..)" "0x\\1," bytes "${hex}")
  file(WRITE ${OUT} "extern const char ${SYM}[];\nconst char ${SYM}[] = {${bytes}0};\n")
endif()
