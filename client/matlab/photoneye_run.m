function [counts, report] = photoneye_run(spec, server)
% PHOTONEYE_RUN runs an experiment and returns counts [frame, cone] and the report.
%   spec    the experiment as JSON text
%   server  for example 'http://127.0.0.1:7733'
% What the job warns of is a warning, for example that the audit found an error above accuracy.target.

job = webwrite([server '/v1/jobs'], 'spec', spec);
where = [server '/v1/jobs/' job.id];
while any(strcmp(job.state, {'QUEUED', 'RUNNING'}))
    pause(0.5);
    job = webread(where);
end
if ~strcmp(job.state, 'SUCCEEDED')
    error('photoneye:job', 'the job ended %s', job.state);
end
if isfield(job, 'warnings') && ~isempty(job.warnings)
    texts = cellstr(job.warnings);
    for k = 1:numel(texts)
        warning('photoneye:job', '%s', texts{k});
    end
end
report = webread([where '/report']);

% counts.npy: 10 bytes, a text header of the length in bytes 9 and 10, then the values, last index fastest.
bytes = webread([where '/counts.npy'], weboptions('ContentType', 'binary'));
bytes = bytes(:)';
length_of_header = double(bytes(9)) + 256 * double(bytes(10));
header = char(bytes(11:10 + length_of_header));
shape = str2double(regexp(header, '\d+', 'match'));
shape = shape(end - 1:end);
if contains(header, '<f4'), type = 'single'; else, type = 'uint32'; end
values = typecast(uint8(bytes(11 + length_of_header:end)), type);
counts = reshape(values, fliplr(shape))';
end
