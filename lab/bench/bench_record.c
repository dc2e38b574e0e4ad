/* Lines of a recorded study (lab/runs/README.md) from a benchmark that scores pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "lab/bench/bench.h"

enum err_code bench_record(struct bench *b, const char *row, const char *what, json_t *numbers,
                           struct err *e)
{
    json_t *o = json_pack("{s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:f, s:f, s:o}", "study", b->study,
                          "row", row, "what", what, "dataset", b->dataset, "command", b->command,
                          "commit", b->commit, "device", b->dev->name, "fma_gflops", b->fma_gflops,
                          "triad_gbps", b->triad_gbps, "numbers", numbers);
    if (!b->lines)
        b->lines = json_array();
    return o && b->lines && !json_array_append_new(b->lines, o)
               ? ERR_OK
               : err_set(e, ERR_MEM, "out of memory for a record");
}

enum err_code bench_record_write(struct bench *b, struct err *e)
{
    struct buf text = {0};
    json_t *line;
    size_t i;
    json_array_foreach(b->lines, i, line)
    {
        char *s = json_dumps(line, JSON_COMPACT | JSON_REAL_PRECISION(7));
        buf_printf(&text, "%s\n", s ? s : "");
        free(s);
    }
    enum err_code rc = buf_check(&text, e);
    if (!rc && b->record)
        rc = file_write(b->record, text.data, text.size, e);
    buf_free(&text);
    json_decref(b->lines);
    b->lines = NULL;
    return rc;
}
