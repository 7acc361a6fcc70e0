# SPDX-License-Identifier: Apache-2.0

# Given by ./dev as CMAKE_PROJECT_INCLUDE, and only where ROS comes from wheels.
#
# Their exported targets name include folders of the machine that built them, which CMake refuses to use.
# At the end of the project's CMakeLists.txt, drop from every imported target the folders that do not exist.

function(drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      set(present "")
      foreach(include IN LISTS includes)
        if(include MATCHES "^\\$<" OR EXISTS "${include}")
          list(APPEND present "${include}")
        endif()
      endforeach()
      set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${present}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_missing_includes)
