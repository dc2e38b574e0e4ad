# The Debian package, by `cpack`: docs/building.md. Included by CMakeLists.txt.
#
# SPDX-License-Identifier: Apache-2.0
find_program(NODE_OF_PACKAGE NAMES node nodejs)
find_program(DPKG dpkg)
if(NOT NODE_OF_PACKAGE OR NOT DPKG)
  return()
endif()
set(CITYSPLAT_PACKAGER "citysplat's packagers <root@localhost>" CACHE STRING "Maintainer of the Debian package")

# What the package has beside program, plug-ins, manual pages, completions and viewer. Not of `cmake --install` itself.
set(deb ${CMAKE_CURRENT_SOURCE_DIR}/configs/deb)
set(doc ${CMAKE_INSTALL_DATADIR}/doc/citysplat)
set(of_package COMPONENT package EXCLUDE_FROM_ALL)
install(CODE "
  set(to \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${doc}\")
  file(MAKE_DIRECTORY \"\${to}\")
  execute_process(COMMAND_ERROR_IS_FATAL ANY COMMAND ${NODE_OF_PACKAGE} ${deb}/sbom.mjs --texts \"\${to}/licences-npm.txt\"
    --sbom \"\${to}/sbom.spdx.json\" --version ${PROJECT_VERSION}
    $<TARGET_FILE:citysplat> $<TARGET_FILE:citysplat-image> $<TARGET_FILE:citysplat-gdal>)" ${of_package})
install(FILES ${deb}/copyright CHANGELOG.md README.md docs/tutorial.md docs/licences.md DESTINATION ${doc} ${of_package})
install(FILES configs/citysplat.service configs/citysplat.socket DESTINATION lib/systemd/system ${of_package})
install(FILES configs/serve.jsonc DESTINATION /etc/citysplat ${of_package})
install(DIRECTORY configs/ DESTINATION ${doc}/examples ${of_package}
  PATTERN deb EXCLUDE PATTERN Containerfile EXCLUDE PATTERN citysplat.service EXCLUDE PATTERN citysplat.socket EXCLUDE)
install(CODE "
  file(GLOB pages \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_MANDIR}/man1/*.1\")
  execute_process(COMMAND_ERROR_IS_FATAL ANY COMMAND gzip -9nf \${pages} \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${doc}/CHANGELOG.md\")"
  ${of_package})

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME citysplat)
set(CPACK_PACKAGE_CONTACT ${CITYSPLAT_PACKAGER})
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "drone photographs to a streamable city of 3D Gaussians")
set(CPACK_PACKAGE_DESCRIPTION "Trains 3D Gaussians at several levels of detail from photographs with poses, cuts them
into tiles of a quadtree, and serves them to web maps: compressed for clients that draw Gaussians, as pictures for
those that do not. Writes orthophotos, surface models, contour lines and points.")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_INSTALL_CMAKE_PROJECTS "${CMAKE_BINARY_DIR};citysplat;Unspecified;/" "${CMAKE_BINARY_DIR};citysplat;package;/")
set(CPACK_STRIP_FILES ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_RECOMMENDS "pocl-opencl-icd | opencl-icd")
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "colmap, geographiclib-tools")
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_DEPENDS passwd)
set(CPACK_DEBIAN_PACKAGE_CONTROL_EXTRA ${deb}/postinst ${deb}/prerm ${deb}/postrm ${deb}/conffiles)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
include(CPack)
