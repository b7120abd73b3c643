# fish_env with its kernels compiled, for machines without a display:
#
#   docker build -t fish_env . && docker run --rm fish_env
FROM python:3.12-slim
# the wheels of torch for the processor are a tenth of those for GPUs
ARG TORCH=https://download.pytorch.org/whl/cpu

RUN useradd --create-home fish && install -d -o fish /opt/kernels
WORKDIR /opt/fish_env
COPY . .
RUN pip install --no-cache-dir -c constraints.txt --extra-index-url "$TORCH" ".[train]"

# kernels go to a folder of the user, who can add others; SDL draws without a display
ENV FISH_ENV_CACHE=/opt/kernels SDL_VIDEODRIVER=dummy
USER fish
WORKDIR /home/fish
RUN python -m fish_env compile
CMD ["python", "-m", "fish_env", "evaluate", "swim", "--episodes", "20"]
