/* See tileset_links.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/tileset_links.h"

#include <string.h>

#include "server/base/format.h"
#include "server/documents/link.h"

enum err_code tileset_links_make(const struct dataset *d, enum tileset_links_of of,
                                 const char *query, struct buf *text, struct tileset_links *out,
                                 struct err *e)
{
    /* A part lies three folders below the entry, in the folder of all parts: tileset/{z}/{x}/. */
    struct link l = link_to(of == TILESET_LINKS_MOVING ? LINK_DATASET : LINK_REVISION,
                            of == TILESET_LINKS_PART ? "../../.." : NULL, d, d->edition);
    size_t at[2];
    const enum format forms[] = {FORMAT_GLB, FORMAT_GLB_LOWPASS};
    for (size_t i = 0; i < 2; i++) {
        l.ext = format_ext(forms[i]);
        link_tile(&l, text);
        buf_printf(text, "%s", query);
        buf_u8(text, 0);
        at[i] = text->size;
    }
    if (of == TILESET_LINKS_PART) {
        struct buf part = {0};
        l.up = NULL;
        link_tileset_part(&l, &part);
        buf_u8(&part, 0);
        buf_printf(text, "../..%s%s", part.failed ? "" : strchr((char *)part.data, '/'), query);
        buf_free(&part);
    } else {
        link_tileset_part(&l, text);
        buf_printf(text, "%s", query);
    }
    buf_u8(text, 0);
    if (text->failed)
        return buf_check(text, e);
    out->tile = (const char *)text->data;
    out->lowpass = (const char *)text->data + at[0];
    out->part = (const char *)text->data + at[1];
    return ERR_OK;
}
