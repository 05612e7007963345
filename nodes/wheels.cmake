# Included by CMake after the project() of each message package that is built with wheels; colcon does not need it.
#
# Message packages that were built elsewhere and unpacked here (as Python wheels are) export the include directories of
# the machine they were built on. CMake stops at a directory that does not exist, so those are taken off, after
# everything has been found and before generation.
function(fsai_drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(present "")
    foreach(directory IN LISTS directories)
      if(NOT IS_ABSOLUTE "${directory}" OR IS_DIRECTORY "${directory}")
        list(APPEND present "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${present}")
  endforeach()
endfunction()
cmake_language(DEFER CALL fsai_drop_missing_include_directories)

# Nothing here is C++: of the ten generators the six of C and Python are enough. (Each package found registers its
# own, once.) Fast DDS asks the introspection's of C for the types that it announces.
find_package(rosidl_default_generators REQUIRED)
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")

# The C++ of a package's messages is compiled as one file: most of each is the headers, which all of them include.
function(fsai_compile_at_once)
  foreach(kind rosidl_typesupport_fastrtps_c rosidl_typesupport_c)
    if(TARGET ${PROJECT_NAME}__${kind})
      set_target_properties(${PROJECT_NAME}__${kind} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL fsai_compile_at_once)
