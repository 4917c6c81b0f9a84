# For the ROS 2 wheels of PyPI only (pass with -DCMAKE_PROJECT_INCLUDE=); a full ROS installation needs none of this.
#
# The CMake targets that those wheels export name include folders of the machine that built them, and CMake refuses a
# target with a folder that does not exist. Drop such folders from all imported targets once the project's own
# CMakeLists.txt has been read, before CMake generates the build.

function(drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(kept "")
    foreach(directory IN LISTS directories)
      # A generator expression is no folder yet; whoever wrote it answers for it.
      if(directory MATCHES "^\\$<" OR EXISTS "${directory}")
        list(APPEND kept "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_missing_include_directories)

# The nodes are Python: without the C++ side of the messages the build takes half as long.
find_package(rosidl_default_generators REQUIRED)
macro(rosidl_generate_interfaces)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "cpp")
  _rosidl_generate_interfaces(${ARGV})
endmacro()
