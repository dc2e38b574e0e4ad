/* JSON documents that describe the service: see service_document.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/service_document.h"

#include <jansson.h>

#include "server/base/document.h"
#include "server/documents/link.h"

enum err_code service_document_landing(struct body **out, struct err *e)
{
    static const struct {
        const char *rel, *type, *title;
        void (*to)(const struct link *l, struct buf *out);
    } rows[] = {
        {"service-desc", "application/vnd.oai.openapi+json;version=3.0", "OpenAPI description",
         link_api},
        {"service-doc", "text/html", "All addresses, to read", link_api_page},
        {"conformance", "application/json", "Conformance classes", link_conformance},
        {"data", "application/json", "Datasets", link_collections},
    };
    const struct link root = {.from = LINK_ROOT};
    char href[64];
    json_t *links =
        json_pack("[o]", document_link("self", "application/json", "./", "This document"));
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        json_array_append_new(links, document_link(rows[i].rel, rows[i].type,
                                                   link_text(rows[i].to, &root, href, sizeof href),
                                                   rows[i].title));
    return document_make(json_pack("{s:s,s:s,s:o}", "title", "citysplat", "description",
                                   "Cities of 3D Gaussians, in tiles and in pictures", "links",
                                   links),
                         out, e);
}

enum err_code service_document_conformance(struct body **out, struct err *e)
{
    static const char *const classes[] = {
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/core",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/landing-page",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/json",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/oas30",
        "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/collections",
        "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/json",
        "https://www.opengis.net/spec/ogcapi-geovolumes-1/1.0/conf/core",
        "https://www.opengis.net/spec/ogcapi-geovolumes-1/1.0/conf/3d-tiles",
    };
    json_t *list = json_array();
    for (size_t i = 0; i < sizeof classes / sizeof *classes; i++)
        json_array_append_new(list, json_string(classes[i]));
    return document_make(json_pack("{s:o}", "conformsTo", list), out, e);
}
