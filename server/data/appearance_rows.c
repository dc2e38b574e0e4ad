/* See appearance_rows.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/appearance_rows.h"

void appearance_rows_close(struct appearance_rows **r)
{
    if (*r) {
        mem_free((*r)->row);
        mem_free((*r)->sample);
    }
    mem_free(*r);
    *r = NULL;
}
