# The interpreter of tests in Python: the one with the programs that mtled is compared with
# (scripts/install_dependencies.sh --with-references), else Debian's, which sees the packages that
# scripts/install_dependencies.sh installs, else any on PATH. -DPython3_EXECUTABLE=... names another.
if(NOT DEFINED CACHE{Python3_EXECUTABLE})
  foreach(python ${CMAKE_BINARY_DIR}/references/bin/python3 /usr/bin/python3)
    if(EXISTS ${python} AND NOT Python3_EXECUTABLE)
      execute_process(COMMAND ${python} -c "import numpy" RESULT_VARIABLE without_numpy OUTPUT_QUIET ERROR_QUIET)
      if(NOT without_numpy)
        set(Python3_EXECUTABLE ${python})
      endif()
    endif()
  endforeach()
endif()
find_package(Python3 COMPONENTS Interpreter)
